"""Thresholds and bounds hold what they promise."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom

from stages.analysis.detection import explained_share, share_reaching, threshold_at, upper_bound, upper_bound_by_group


@settings(deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=1, max_size=200), st.sampled_from([0.5, 0.9, 0.99]))
def test_the_threshold_is_the_highest_that_enough_scores_reach(scores: list[float], detection: float) -> None:
    threshold = threshold_at(scores, detection)
    assert share_reaching(scores, threshold) >= detection
    assert share_reaching(scores, np.nextafter(threshold, 2)) < detection


@settings(deadline=None)
@given(st.integers(0, 20), st.integers(1, 400))
def test_at_the_bound_so_few_would_be_rare(successes: int, trials: int) -> None:
    bound = upper_bound(successes, trials)
    if successes < trials:
        assert binom.cdf(successes, trials, bound) == pytest.approx(0.05)
    else:
        assert bound == 1


def test_three_thousand_pictures_of_three_scenes_are_three_trials() -> None:
    scenes = ["fox"] * 1000 + ["bonsai"] * 1000 + ["kitchen"] * 1000
    assert upper_bound(0, 3000) < 1e-3
    assert upper_bound_by_group(scenes, []) == upper_bound(0, 3)
    assert upper_bound_by_group(scenes, [5, 7, 999]) == upper_bound(1, 3)


def test_black_explains_nothing_and_the_watermark_all() -> None:
    watermark = torch.rand(4, 6, 3, generator=torch.Generator().manual_seed(0))
    assert explained_share(watermark, watermark) == 1
    assert explained_share(torch.zeros_like(watermark), watermark) == 0
    assert explained_share(watermark / 2, watermark) == pytest.approx(0.75)
    with pytest.raises(ValueError, match="black watermark"):
        explained_share(watermark, torch.zeros_like(watermark))
