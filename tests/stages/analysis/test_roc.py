"""Curves and areas agree with pairs counted one by one, and intervals cover what they should."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import binom, norm

from stages.analysis.roc import (
    Area,
    DetectorScores,
    bootstrap_area,
    bootstrap_excess,
    is_upside_down,
    roc_curve,
    two_sided,
)

VALUES = st.lists(st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0, math.nan]), min_size=1, max_size=8)


def scores(positives: list[float], negatives: list[float], paired: bool = False) -> DetectorScores:
    return DetectorScores(np.array(positives), np.array(negatives), paired)


def counted(scene: DetectorScores) -> float:
    """The area, from every pair of views, one by one."""
    pairs = [
        (p > q) + 0.5 * (p == q)
        for p in scene.positives
        for q in scene.negatives
        if not (math.isnan(p) or math.isnan(q))
    ]
    return sum(pairs) / len(pairs)


def area_under(curve: Sequence[tuple[float, float]]) -> float:
    """The area under a curve of `roc_curve`, whose points are joined by straight lines; NaN for an empty one."""
    if not curve:
        return math.nan
    false, true = np.array(curve).T
    return float(((true[1:] + true[:-1]) / 2 * np.diff(false)).sum())


@settings(max_examples=100, deadline=None)
@given(lists=st.lists(st.tuples(VALUES, VALUES), min_size=1, max_size=3))
def test_the_area_is_how_often_a_positive_is_above_a_negative(lists: list[tuple[list[float], list[float]]]) -> None:
    scenes = [scores(*pair) for pair in lists]
    usable = [scene for scene in scenes if scene.usable]
    curve = roc_curve(scenes)
    area = bootstrap_area(scenes, seed=0, repeats=20)
    if not usable:
        assert curve == ()
        assert math.isnan(area.value)
        assert math.isnan(area_under(curve))
        return
    assert area.value == pytest.approx(np.mean([counted(scene) for scene in usable]))
    assert area.value == pytest.approx(np.mean([area_under(roc_curve([scene])) for scene in usable]))
    assert curve[0] == (0, 0)
    assert curve[-1] == pytest.approx((1, 1))
    assert all(a[0] <= b[0] and a[1] <= b[1] for a, b in pairwise(curve))


def test_numbers_of_views_are_no_evidence() -> None:
    """The detector tells two scenes apart, but not the classes within either: the pooled area is that of chance."""
    many, few = [0.1] * 50, [0.1] * 2
    scenes = [scores(many, few), scores([0.9] * 2, [0.9] * 50)]
    assert area_under(roc_curve(scenes)) == pytest.approx(0.5)


def test_a_scene_that_was_trained_twice_counts_once() -> None:
    fox, bonsai = (
        DetectorScores(np.array(positives), np.array(negatives), scene=name)
        for name, positives, negatives in (("fox", [0.8, 0.9], [0.1, 0.2]), ("bonsai", [0.1, 0.2], [0.8, 0.9]))
    )
    assert area_under(roc_curve([fox, fox, bonsai])) == pytest.approx(0.5)
    assert bootstrap_area([fox, fox, bonsai], 0).value == pytest.approx(0.5)


def test_a_detector_that_is_always_wrong_is_as_good_as_its_opposite() -> None:
    wrong = [scores([0.1, 0.2], [0.3, 0.4])]
    assert (bootstrap_area(wrong, 0).value, bootstrap_area(two_sided(wrong), 0).value) == (0, 1)
    values = np.random.default_rng(0).normal(0, 1, (2, 60)) - [[0.1], [0]]
    unsure = [DetectorScores(*values)]
    area, turned = bootstrap_area(unsure, 0), bootstrap_area(two_sided(unsure), 0)
    assert area.low < area.value < 0.5 < area.high
    expected = (1 - area.value, 1 - area.high, 1 - area.low)
    assert (turned.value, turned.low, turned.high) == pytest.approx(expected), "chance is still not ruled out"
    assert bootstrap_area(two_sided([unsure[0].opposite]), 0) == turned


def test_each_scene_is_turned_by_itself() -> None:
    """The mean decides in a scene with two detectors; scenes without usable scores are left out."""
    right, wrong = scores([1.0] * 4, [0.0] * 4), scores([0.0] * 4, [1.0] * 4)
    unsure = scores([0.0, 1.0] * 2, [0.5] * 4)
    of_fox = [replace(each, scene="fox") for each in (wrong, unsure)]
    without = scores([math.nan], [1.0])
    scenes = ([right], [wrong], of_fox, [], [unsure], [wrong, without])
    assert [is_upside_down(each) for each in scenes] == [False, True, True, False, False, True]
    both_ways = [right, replace(wrong, scene="bonsai"), *of_fox, without]
    assert bootstrap_area(two_sided(both_ways), 0).value == pytest.approx((1 + 1 + 0.75) / 3)


def test_intervals_cover_the_truth() -> None:
    """The classes differ by one standard deviation, so the area within a scene is Φ(1 / √2) = 0.760.

    In nearly all of 60 experiments with ten scenes, the interval should cover it.
    """
    generator = np.random.default_rng(0)
    covered = 0
    for seed in range(60):
        scenes = [scores(list(generator.normal(1, 1, 60)), list(generator.normal(0, 1, 60))) for _ in range(10)]
        area = bootstrap_area(scenes, seed, repeats=300)
        covered += area.low <= 0.760 <= area.high
        assert area.low <= area.value <= area.high
    assert covered >= 52


@pytest.mark.parametrize("paired", [False, True])
def test_intervals_cover_the_truth_where_neighbours_look_alike(paired: bool) -> None:
    """One scene of 250 views; scores of neighbouring views have a correlation of 0.9, as with renders."""
    generator = np.random.default_rng(0)
    covered = 0
    for seed in range(60):
        common = neighbours_alike(generator, 0.9) if paired else 0
        positives, negatives = (common + neighbours_alike(generator, 0.9) + shift for shift in (0.5, 0))
        area = bootstrap_area([DetectorScores(positives, negatives, paired)], seed, repeats=300)
        covered += area.low <= norm.cdf(0.5 / (2 + 2 * paired) ** 0.5) <= area.high
    assert covered >= 50


def neighbours_alike(generator: np.random.Generator, correlation: float) -> np.ndarray:
    """Scores of 250 views, with deviation 1 and this correlation between neighbours."""
    steps = generator.normal(0, (1 - correlation**2) ** 0.5, 350)
    return lfilter([1], [1, -correlation], steps)[100:]


def test_intervals_of_pairs_seldom_claim_too_much() -> None:
    """What a view shows decides its score, and both classes show the same; noise of their own is a tenth of that.

    Views near each other are then told apart best, and a run that is drawn twice is compared with itself more often.
    """
    generator = np.random.default_rng(0)
    truth = norm.cdf(0.3 / (2 * (1 + 0.1**2)) ** 0.5)
    above = 0
    for seed in range(200):
        common = neighbours_alike(generator, 0.95)
        positives, negatives = (common + 0.1 * neighbours_alike(generator, 0.5) + shift for shift in (0.3, 0))
        above += bootstrap_area([DetectorScores(positives, negatives, paired=True)], seed, repeats=300).low > truth
    assert above <= 30


def test_an_interval_leaves_out_one_in_forty_at_either_end() -> None:
    """The detector is right in half of 16 scenes, so the number of such scenes among 16 drawn ones is binomial.

    They have more views than the others, which counts for nothing.
    """
    scenes = [scores([1.0] * 9, [0.0])] * 8 + [scores([0.0], [1.0])] * 8
    area = bootstrap_area(scenes, seed=0, repeats=10_000)
    assert (area.low, area.high) == pytest.approx(tuple(binom.ppf([1 / 40, 39 / 40], 16, 0.5) / 16))


def test_an_interval_of_few_views_is_widened_as_a_mean_of_few_is() -> None:
    """The detector is right on some of six positives, so their number among six drawn ones is binomial.

    Six values have Student's quantile for five degrees of freedom, and as a population too small a variance. The class
    with the fewest runs decides, and an area stays one.
    """
    wider = 2.5706 / 1.9600 * math.sqrt(6 / 5)
    half, most = (scores([1.0] * right + [0.0] * (6 - right), [0.5] * 8) for right in (3, 5))
    area = bootstrap_area([half], seed=0, repeats=10_000)
    binomial = binom.ppf([1 / 40, 39 / 40], 6, 0.5) / 6
    assert (area.low, area.high) == pytest.approx(tuple(0.5 + wider * (binomial - 0.5)), abs=1e-4)
    assert bootstrap_area([most], seed=0).high == 1
    single = bootstrap_area([scores([0.5], [0.0] * 30 + [1.0] * 30)], seed=0)
    assert single.low < single.value < single.high, "of one class there is no choice, but of the other"


def test_a_draw_without_a_score_says_nothing() -> None:
    """In a third of the draws of six views, the only one with a score is missing."""
    rare = scores([1.0] + [math.nan] * 5, [0.0] * 6)
    assert bootstrap_area([rare], seed=0) == Area(1, 1, 1)
    assert bootstrap_area([rare, scores([1.0] * 6, [0.0] * 6)], seed=0) == Area(1, 1, 1)


def test_neighbours_that_look_alike_widen_the_interval() -> None:
    generator = np.random.default_rng(0)
    alone = scores(list(generator.normal(0.5, 1, 250)), list(generator.normal(0, 1, 250)))
    alike = scores(list(np.repeat(alone.positives[:25], 10)), list(np.repeat(alone.negatives[:25], 10)))
    narrow, wide = (bootstrap_area([each], seed=0) for each in (alone, alike))
    assert wide.high - wide.low > 2 * (narrow.high - narrow.low)


def test_pairs_are_drawn_together() -> None:
    """Both classes' scores vary with the camera, so their difference is surer if the same cameras are drawn of both."""
    generator = np.random.default_rng(0)
    camera = generator.normal(0, 1, 100)
    paired, apart = (scores(list(camera + 0.01), list(camera), paired) for paired in (True, False))
    sure, unsure = (bootstrap_area([each], seed=0) for each in (paired, apart))
    assert sure.high - sure.low < 0.3 * (unsure.high - unsure.low)


def test_a_difference_of_areas_is_that_of_one_draw() -> None:
    generator = np.random.default_rng(0)
    clean, again, noise = generator.normal(0, 1, (3, 80))
    own, control = (scores(list(values), list(clean), paired=True) for values in (again + 0.5, again))
    assert bootstrap_excess([own], [own], 0) == Area(0, 0, 0)
    excess = bootstrap_excess([own], [control], 0)
    assert excess.value == pytest.approx(counted(own) - counted(control))
    apart = bootstrap_excess([own], [scores(list(noise), list(clean), paired=True)], 0)
    assert excess.high - excess.low < 0.6 * (apart.high - apart.low)
    assert math.isnan(bootstrap_excess([], [], 0).value)
    fewer = replace(control, negatives=control.negatives[1:])
    for other in (scores([1.0], [0.0]), replace(control, scene="bonsai"), fewer):
        with pytest.raises(ValueError, match="other scenes or views"):
            bootstrap_excess([own], [other], 0)


def test_the_seed_decides() -> None:
    scene = DetectorScores(*np.random.default_rng(0).normal(0, 1, (2, 60)))
    assert bootstrap_area([scene], seed=1) == bootstrap_area([scene], seed=1)
    assert bootstrap_area([scene], seed=1) != bootstrap_area([scene], seed=2)
    assert bootstrap_excess([scene], [scene.opposite], 1) == bootstrap_excess([scene], [scene.opposite], 1)
    assert bootstrap_excess([scene], [scene.opposite], 1) != bootstrap_excess([scene], [scene.opposite], 2)


def test_classes_are_compared_within_scenes() -> None:
    scenes = [scores([1.1, 1.3], [1.0, 1.2]), scores([9.0, 9.0], [7.0, 8.0]), scores([math.nan], [1.0])]
    assert bootstrap_area(scenes, 0).value == pytest.approx((0.75 + 1) / 2)
    area = bootstrap_area([scores([1.0] * 4, [0.0] * 4), scores([0.0] * 4, [1.0] * 4)], 0)
    assert (area.low, area.value, area.high) == pytest.approx((0, 0.5, 1))


def test_detectors_of_one_scene_are_no_scenes() -> None:
    """With two scenes, more detectors of each do not narrow the interval: a third scene could give anything."""
    good, bad = scores([1.0] * 4, [0.0] * 4), scores([0.0] * 4, [1.0] * 4)
    two = [replace(good, scene="fox"), replace(bad, scene="bonsai")]
    assert bootstrap_area([*two, *two, two[0]], 0) == Area(0.5, 0.0, 1.0)
    [low, high] = (getattr(bootstrap_area([two[0], replace(bad, scene="fox")], 0), end) for end in ("low", "high"))
    assert (low, high) == (0, 1), "of one scene, its detectors are drawn"
