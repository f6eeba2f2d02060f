"""Expectations are of Gaussians about as much the cover's, none of which is farther off, and are read from files."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from stages.hiding.expected import FACTS, KNOTS, Expected, knots_of, reaches_of, readings_of

THREE = Expected(np.array([0.0, 0.5, 1.0]), np.array([[0.0, 1.0], [2.0, 1.0], [4.0, 3.0]]), np.array([1.0, 2.0, 1.5]))


def test_between_shares_they_go_over_into_each_other() -> None:
    shares = torch.tensor([-1.0, 0.25, 0.5, 0.75, 9.0]).double()
    expected = [[0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [3.0, 2.0], [4.0, 3.0]]
    assert THREE.readings_at(shares).tolist() == expected
    assert THREE.reaches_at(shares).tolist() == [1.0, 1.5, 2.0, 1.75, 1.5]


@given(count=st.integers(0, 3000), digits=st.integers(0, 6), seed=st.integers(0, 2**32 - 1))
def test_none_is_farther_off_than_expected(count: int, digits: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    shares = torch.from_numpy(generator.normal(size=count).round(digits))
    distances = torch.from_numpy(generator.exponential(size=count))
    knots = knots_of(shares)
    expected = Expected(knots, np.zeros((len(knots), 1)), reaches_of(shares, distances, knots))
    assert 1 <= len(knots) <= KNOTS
    assert (expected.reaches_at(shares) >= distances - 1e-9).all()
    assert (expected.reaches > 0).all()


def test_few_gaussians_have_few_knots() -> None:
    assert [len(knots_of(torch.linspace(0, 1, count).double())) for count in (0, 1, 499, 500, 10**5)] == [
        1,
        1,
        1,
        2,
        16,
    ]


def test_readings_are_means_of_those_nearest() -> None:
    shares = torch.tensor([0.0, 0.1, 0.9, 1.0]).double()
    means = readings_of(shares, torch.tensor([[1.0], [3.0], [5.0], [9.0]]).double(), np.array([0.0, 1.0]))
    assert means.tolist() == [[2.0], [7.0]]


def test_they_are_read_back_from_a_file() -> None:
    again = Expected.from_facts(json.loads(json.dumps(THREE.facts(), sort_keys=True)), 2)
    assert all(np.array_equal(getattr(again, name), values) for name, values in vars(THREE).items())


@pytest.mark.parametrize(
    "wrong",
    [
        dict.fromkeys(FACTS),
        {name: [] for name in FACTS},
        {"expected_cover_shares": [0.0, 0.0, 1.0]},
        {"expected_cover_shares": "abc"},
        {"expected_cover_shares": 3},
        {"expected_cover_shares": [0.0, float("nan"), 1.0]},
        {"expected_readings": [1.0, 1.0, 1.0]},
        {"expected_readings": [[1.0, 2.0], [1.0], [1.0]]},
        {"expected_reaches": [1.0, 0.0, 1.0]},
    ],
)
def test_whatever_is_none_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="expect"):
        Expected.from_facts(THREE.facts() | wrong, 2)
    with pytest.raises(ValueError, match="expect"):
        Expected.from_facts({}, 2)
