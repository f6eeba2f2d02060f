"""Expectations come from Gaussians with similar cover shares, bound all distances, and are restored from files."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from stages.hiding.expected import FACTS, KNOTS, Expected, expectations

THREE = Expected(
    np.array([0.0, 0.5, 1.0]),
    np.array([[0.0, 1.0], [2.0, 1.0], [4.0, 3.0]]),
    np.array([0.1, 0.2, 0.1]),
    np.array([1.0, 2.0, 1.5]),
)


def of_distances(shares: torch.Tensor, distances: torch.Tensor) -> Expected:
    return expectations(shares, torch.zeros(len(shares), 1, dtype=torch.float64), lambda _: distances)


def test_between_shares_they_go_over_into_each_other() -> None:
    shares = torch.tensor([-1.0, 0.25, 0.5, 0.75, 9.0]).double()
    assert THREE.readings_at(shares).tolist() == [[0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [3.0, 2.0], [4.0, 3.0]]
    farthest = THREE.distances(shares, torch.ones(5, dtype=torch.float64))
    torch.testing.assert_close(farthest, torch.tensor([1.0, 1.5, 2.0, 1.75, 1.5]).double())


@given(shares=st.lists(st.floats(-1, 2), max_size=20), length=st.floats(0, 1))
def test_lengths_are_put_back(shares: list[float], length: float) -> None:
    at, lengths = torch.tensor(shares).double(), torch.full((len(shares),), length, dtype=torch.float64)
    distances = THREE.distances(at, lengths)
    assert ((distances >= 0) & (distances < 2.01)).all()
    torch.testing.assert_close(THREE.lengths(at, distances), lengths, rtol=0, atol=1e-12)


def test_usual_distances_are_not_next_to_nothing() -> None:
    at, usual = torch.tensor([0.0, 0.5]).double(), torch.tensor([0.1, 0.2]).double()
    assert (THREE.lengths(at, usual) > 0.25).all()


@given(count=st.integers(0, 3000), digits=st.integers(0, 6), seed=st.integers(0, 2**32 - 1))
def test_none_is_farther_off_than_expected(count: int, digits: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    shares = torch.from_numpy(generator.normal(size=count).round(digits))
    distances = torch.from_numpy(generator.exponential(size=count))
    expected = of_distances(shares, distances)
    assert 1 <= len(expected.cover_shares) <= KNOTS
    assert (expected.lengths(shares, distances) <= 1 + 1e-9).all()
    assert (expected.farthest >= expected.usual).all()
    assert (expected.usual > 0).all()


def test_few_gaussians_have_few_shares() -> None:
    counts = [0, 1, 499, 500, 10**5]
    found = [of_distances(torch.linspace(0, 1, count).double(), torch.zeros(count).double()) for count in counts]
    assert [len(each.cover_shares) for each in found] == [1, 1, 1, 2, 16]


def test_shares_that_are_alike_are_one() -> None:
    shares = torch.linspace(0.5, 0.5001, 10**4).double()
    assert of_distances(shares, torch.zeros(10**4).double()).cover_shares.tolist() == pytest.approx([0.5])


def test_the_usual_distance_is_the_median() -> None:
    expected = of_distances(torch.zeros(3).double(), torch.tensor([1.0, 2.0, 9.0]).double())
    assert (expected.usual.tolist(), expected.farthest.tolist()) == ([2.0], [9.0])


def test_readings_are_means_of_those_nearest() -> None:
    shares = torch.tensor([0.0] * 250 + [0.1] * 250 + [0.9] * 250 + [1.0] * 250).double()
    readings = torch.tensor([1.0, 3.0, 5.0, 9.0]).double().repeat_interleave(250)[:, None]
    expected = expectations(shares, readings, lambda _: torch.zeros(1000).double())
    assert expected.cover_shares.tolist() == pytest.approx([0.0, 0.1, 0.9, 1.0])
    assert expected.readings[:, 0].tolist() == [1.0, 3.0, 5.0, 9.0]
    of_one = expectations(shares[::5], readings[::5], lambda _: torch.zeros(200).double())
    assert of_one.readings.tolist() == [[4.5]]


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
        {"usual_distances": [0.1, 0.0, 0.1]},
        {"usual_distances": [0.1, 5e-324, 0.1]},
        {"farthest_distances": [1.0, 1.7e308, 1.0]},
        {"expected_readings": [1.0, 1.0, 1.0, -1e300, 1.0, 1.0]},
        {"farthest_distances": [1.0, 0.1, 1.0]},
        {"farthest_distances": [1.0, 1.1e6, 1.0]},
        {"expected_readings": [1.0, 1.0, 1.0, -1.1e6, 1.0, 1.0]},
    ],
)
def test_whatever_is_none_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="expect"):
        Expected.from_facts(THREE.facts() | wrong, 2)
    with pytest.raises(ValueError, match="expect"):
        Expected.from_facts({}, 2)
