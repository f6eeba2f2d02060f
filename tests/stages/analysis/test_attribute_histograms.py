"""Divergences of histograms: their bounds, what they notice, and what must not affect them."""

from __future__ import annotations

import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.analysis import attribute_histograms
from stages.analysis.attribute_histograms import (
    BINS,
    CHANNELS,
    DIVERGENCE,
    GAUSSIANS,
    ONLY_THERE,
    compare_attributes,
    counted,
    divergence,
    edges_of,
    histogram_rows,
    jensen_shannon,
    of_attribute,
)

COUNTS = st.lists(st.integers(0, 20), min_size=3, max_size=3).filter(any)


@settings(deadline=None)
@given(first=COUNTS, second=COUNTS)
def test_a_divergence_is_symmetric_and_within_a_bit(first: list[int], second: list[int]) -> None:
    one, two = np.array(first, float), np.array(second, float)
    value = jensen_shannon(one, two)
    assert 0 <= value <= 1 + 1e-12
    assert jensen_shannon(two, one) == pytest.approx(value)
    assert jensen_shannon(one, 3 * one) == pytest.approx(0, abs=1e-12)


def test_a_divergence_grows_with_what_differs() -> None:
    generator = np.random.default_rng(0)
    own = generator.normal(0, 1, 20_000)
    found = [divergence(own, generator.normal(shift, 1, 20_000)) for shift in (0, 0.3, 1, 20)]
    assert found[0] < 0.005 < found[1] < found[2] < found[3]
    assert found[3] == pytest.approx(1, abs=0.01)
    assert divergence(np.zeros(5), np.zeros(7)) == 0


def test_one_value_in_a_thousand_that_strays_hides_nothing() -> None:
    own, other = np.linspace(0, 1, 1000), np.linspace(0.2, 1.2, 1000)
    strayed = np.append(own[1:], 1e6)
    assert divergence(strayed, other) == pytest.approx(divergence(own, other), abs=0.01)


def test_three_values_in_a_thousand_are_told_apart() -> None:
    """They are more than the outermost bins take; the divergence is then the share of values that differ."""
    alike = np.linspace(0, 1, 997)
    own, other = (np.append(alike, [value] * 3) for value in (2, 3))
    assert divergence(own, other) == pytest.approx(0.003)
    assert divergence(-own, -other) == pytest.approx(0.003)


def test_a_single_value_is_told_from_a_thousand_equal_ones() -> None:
    assert divergence(np.zeros(1000), np.append(np.zeros(999), 1)) == pytest.approx(0.0005, rel=1e-2)


def test_a_value_on_an_edge_counts_above_it() -> None:
    edges = np.array([-np.inf, 1.0, 2.0, np.inf])
    assert counted(np.array([0.0, 1.0, 1.5, 2.0, 9.0]), edges).tolist() == [1, 2, 2]


def container(seed: int, scale: float = 1.0, extra: bool = False) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(seed)
    features = generator.normal(0, 1, (3000, 4)) * [4, 1, 2, scale]
    found = {
        "means": generator.normal(seed, 1, (3000, 3)),
        "quats": generator.normal(0, 1, (3000, 4)),
        "logit_opacities": generator.normal(0, 1, 3000),
        "raw_features": features[:, generator.permutation(4)],
        "sh_rest": np.zeros((3000, 0, 3)),
    }
    return found | ({"message_sh_base": features} if extra else {})


def by_name(*given: dict[str, np.ndarray]) -> dict[str, float]:
    return {row.quantity: row.value for row in compare_attributes(*given, "hidden", "gs_hider")}


def test_channels_in_another_order_are_the_same_and_attributes_of_its_own_are_counted() -> None:
    same, other = by_name(container(1), container(2)), by_name(container(1, 0.2, extra=True), container(2))
    channels = of_attribute(CHANNELS, "raw_features")
    assert same[channels] < 0.02 < other[channels]
    assert same[of_attribute(DIVERGENCE, "logit_opacities")] < 0.02
    assert (same[ONLY_THERE], other[ONLY_THERE]) == (0, 1)
    half = {name: values[:1500] for name, values in container(2).items()}
    assert (same[GAUSSIANS], by_name(container(1), half)[GAUSSIANS]) == (1, 2)
    assert not any("means" in name or "quats" in name or "message" in name for name in other)


def test_histograms_hold_every_value_once() -> None:
    given = {"hidden": container(1, extra=True), "clean": container(2)}
    given["clean"]["logit_opacities"] += 3
    rows = list(histogram_rows(given, "gs_hider"))
    assert {row.quantity for row in rows} == {
        of_attribute("histogram", name) for name in ("logit_opacities", "raw_features")
    }
    for condition in ("hidden", "clean"):
        own = [row for row in rows if row.condition == condition and "opacities" in row.quantity]
        assert len(own) == BINS
        assert sum(row.value for row in own) == pytest.approx(1)
        assert all(first.severity < second.severity for first, second in pairwise(own))
        middle = sum(row.value * row.severity for row in own)
        assert middle == pytest.approx(given[condition]["logit_opacities"].mean(), abs=0.02)


def test_little_memory_is_needed_besides_the_containers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The variances of one container's channels take four bytes a value; samples and counts do not grow with it."""
    monkeypatch.setattr(attribute_histograms, "MOST_AT_ONCE", 10_000, raising=False)
    generator = np.random.default_rng(0)
    hidden, clean, other = (
        {"means": np.zeros((20_000, 3), np.float32), "sh_rest": generator.normal(0, 1, (20_000, 15, 3)).astype("f4")}
        for _ in range(3)
    )
    tracemalloc.start()
    list(compare_attributes(hidden, clean, "hidden", "gs_hider"))
    list(histogram_rows({"hidden": hidden, "clean": clean, "other": other}, "gs_hider"))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 5 * hidden["sh_rest"].size


def test_bins_of_many_values_are_nearly_those_of_all_and_of_every_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = np.random.default_rng(0)
    own, other = (generator.normal(0, 1, (count, 5)) * [1, 2, 3, 4, 5] for count in (40_000, 20_000))
    every = edges_of(own, other)
    monkeypatch.setattr(attribute_histograms, "MOST_AT_ONCE", 20_000)
    np.testing.assert_allclose(edges_of(own, other)[1:-1], every[1:-1], rtol=0, atol=0.05 * every[-2])
    assert counted(own, every).tolist() == counted(own.ravel(), every).tolist()
    assert counted(own, every).sum() == own.size
