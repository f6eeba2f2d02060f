"""A reader's trial: what counts as found, and what is taken for a watermark elsewhere, in pictures made by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stages.analysis.detection import upper_bound
from stages.analysis.watermark_trials import (
    BOUND_AT_99,
    BOUND_BY_SCENE_AT_99,
    CLEAN_CHANNEL,
    DETECTED,
    DETECTED_AT_99,
    FALSE_POSITIVES_AT_99,
    OTHER_SCENES,
    OWN_SCENE,
    PRUNING,
    THRESHOLD,
    THRESHOLD_AT_99,
    TRIALS,
    AttackedRenders,
    Detector,
    Negative,
    Positives,
    trial_rows,
)
from stages.imaging.distortions import DISTORTIONS
from stages.imaging.pictures import Picture, picture_to_tensor


def test_distorted_renders_are_what_is_looked_at() -> None:
    view = np.random.default_rng(1).integers(0, 256, (12, 16, 3)).astype(np.uint8)
    looked: list[Picture] = []
    detector = Detector(lambda picture: looked.append(picture) or picture_to_tensor(picture), view)
    list(trial_rows(detector, Positives([("0.png", view)], [view], []), [], 7, lambda: None))
    for distortion, found in zip(DISTORTIONS, looked[3:], strict=True):
        np.testing.assert_array_equal(found, distortion.apply(view, np.random.default_rng(7)))
        assert not np.array_equal(found, view), distortion.name


def test_every_look_is_counted() -> None:
    black = np.zeros((6, 8, 3), np.uint8)
    positives = Positives(
        [("0.png", black)], [black] * 2, [black] * 3, [AttackedRenders(PRUNING, 0.25, 4, lambda: [black] * 4)]
    )
    looks = []
    detector = Detector(lambda picture: torch.zeros(picture.shape), black + 9)
    rows = list(trial_rows(detector, positives, [], 0, lambda: looks.append(1)))
    assert len(looks) == positives.looked_at
    [trials] = [row for row in rows if (row.quantity, row.condition) == (TRIALS, PRUNING)]
    assert (trials.severity, trials.value) == (0.25, 4)


def test_false_positives_at_99_percent_are_those_that_outdo_the_worst_renders() -> None:
    """One of 100 renders may be missed. The decoder shows the picture itself: brighter ones explain more.

    Renders that are scored do not set the threshold: three of them are darker.
    """

    def grey(level: int) -> Picture:
        return np.full((6, 8, 3), level, np.uint8)

    calibration = [grey(level) for level in (151, 152, *[200] * 98)]
    held_out = [grey(level) for level in (150, 150, *[200] * 97)]
    scenes = {0: "a", 149: "b", 151: "c", 152: "d", 180: "d"}
    others = [(Negative("photos", scene, OTHER_SCENES), grey(level)) for level, scene in scenes.items()]
    own = [(Negative("photos", "cover", OWN_SCENE), grey(151))]
    detector = Detector(picture_to_tensor, grey(200))
    positives = Positives([("0.png", grey(150))], calibration, held_out)
    rows = trial_rows(detector, positives, [*others, *own], 0, lambda: None)
    values = {(row.quantity, row.condition): row.value for row in rows}
    assert values[THRESHOLD_AT_99, CLEAN_CHANNEL] == pytest.approx(1 - (48 / 200) ** 2)
    assert values[DETECTED_AT_99, CLEAN_CHANNEL] == pytest.approx(0.97)
    assert values[FALSE_POSITIVES_AT_99, OTHER_SCENES] == 2
    assert values[BOUND_AT_99, OTHER_SCENES] == upper_bound(2, 5)
    assert values[BOUND_BY_SCENE_AT_99, OTHER_SCENES] == upper_bound(1, 4), "both are of one scene"
    assert values[FALSE_POSITIVES_AT_99, OWN_SCENE] == 0


def test_what_explains_nine_tenths_of_the_watermark_counts_however_sure_a_decoder_is_of_its_renders() -> None:
    picture, fainter = (np.full((6, 8, 3), level, np.uint8) for level in (200, 140))  # the latter explains 0.91
    detector = Detector(picture_to_tensor, picture)
    rows = trial_rows(detector, Positives([("0.png", fainter)], [picture], []), [], 0, lambda: None)
    values = {(row.quantity, row.condition): row.value for row in rows}
    assert (values[THRESHOLD, CLEAN_CHANNEL], values[DETECTED, CLEAN_CHANNEL]) == (0.9, 1)
    assert (values[THRESHOLD_AT_99, CLEAN_CHANNEL], values[DETECTED_AT_99, CLEAN_CHANNEL]) == (1, 0)


@pytest.mark.parametrize(("own_share", "found"), [(0.75, 1), (0.8, 0), (None, 1)])
def test_a_threshold_that_is_known_is_kept_whatever_renders_reach(own_share: float | None, found: float) -> None:
    picture = np.full((6, 8, 3), 200, np.uint8)
    detector = Detector(lambda shown: torch.full(shown.shape, 0.55 * 200 / 255), picture, own_share)  # share 0.7975
    rows = trial_rows(detector, Positives([("0.png", picture)], [picture], []), [], 0, lambda: None)
    values = {(row.quantity, row.condition): row.value for row in rows}
    assert values[DETECTED, CLEAN_CHANNEL] == found
    assert values[THRESHOLD, CLEAN_CHANNEL] == (own_share or pytest.approx(0.7975))
    assert ((THRESHOLD_AT_99, CLEAN_CHANNEL) in values) == (own_share is None)
