"""Some pictures of other scenes are also tried with each distortion, right after the undistorted picture."""

from __future__ import annotations

from itertools import groupby

import numpy as np

from stages.analysis.distorted_negatives import most_distorted, with_distorted
from stages.analysis.watermark_trials import (
    FALSE_POSITIVES,
    FALSE_POSITIVES_DISTORTED,
    NEGATIVES_DISTORTED,
    OTHER_SCENES,
    OWN_SCENE,
    SCENES,
    TRIALS,
    Detector,
    Negative,
    Positives,
    trial_rows,
)
from stages.imaging.distortions import DISTORTIONS
from stages.imaging.pictures import Picture, picture_to_tensor


def picture(number: int) -> Picture:
    return np.random.default_rng(number).integers(0, 256, (12, 16, 3)).astype(np.uint8)


def negatives(totals: list[str | None]) -> list[tuple[Negative, Picture]]:
    return [(Negative("photos", str(number), total), picture(number)) for number, total in enumerate(totals)]


def test_of_every_so_many_of_other_scenes_one_is_distorted_in_every_way() -> None:
    plain = negatives([OTHER_SCENES, OWN_SCENE, None] * 40)
    tried = list(with_distorted(plain, 4, seed=3))
    assert [each for each in tried if each[0].distortion is None] == plain
    drawn = [[*group] for _, group in groupby(tried, lambda each: each[0].scene)]
    drawn = [group for group in drawn if len(group) > 1]
    assert len(drawn) == 10
    assert len({int(group[0][0].scene) // 3 % 4 for group in drawn}) > 1, "not every fourth: sources come in turns"
    for (first, seen), *distorted in drawn:
        assert first.total == OTHER_SCENES
        assert [each.distortion for each, _ in distorted] == [*DISTORTIONS]
        assert {each.total for each, _ in distorted} == {None}
        assert not any(np.array_equal(changed, seen) for _, changed in distorted)
    for each, distortion in enumerate(DISTORTIONS, start=1):
        changed = distortion.apply(drawn[0][0][1], np.random.default_rng(3))
        np.testing.assert_array_equal(drawn[0][each][1], changed)
    assert len(tried) - len(plain) == most_distorted(40, 4)


def test_none_may_be_distorted() -> None:
    plain = negatives([OTHER_SCENES] * 3)
    assert list(with_distorted(plain, 0, seed=0)) == plain
    assert (most_distorted(3, 0), most_distorted(0, 5), most_distorted(3, 5)) == (0, 0, len(DISTORTIONS))


def test_distorted_negatives_are_counted_by_their_distortion_alone() -> None:
    """The decoder shows the picture itself and the watermark is white, so bright pictures reach the threshold."""
    white, grey = (np.full((12, 16, 3), level, np.uint8) for level in (255, 110))
    tried = with_distorted([(Negative("photos", "wall", OTHER_SCENES), grey)], 1, seed=0)
    detector = Detector(picture_to_tensor, white, own_share=1 - (1 - 120 / 255) ** 2)
    rows = list(trial_rows(detector, Positives([("0.png", white)], [], []), tried, 0, lambda: None))
    by_distortion = {
        quantity: {(row.condition, row.severity): row.value for row in rows if row.quantity == quantity}
        for quantity in (NEGATIVES_DISTORTED, FALSE_POSITIVES_DISTORTED)
    }
    conditions = [(each.name, each.severity) for each in DISTORTIONS]
    assert by_distortion[NEGATIVES_DISTORTED] == dict.fromkeys(conditions, 1)
    assert by_distortion[FALSE_POSITIVES_DISTORTED] == dict.fromkeys(conditions, 0) | {("brightness", 1.2): 1}
    sums = {(row.quantity, row.condition): row.value for row in rows}
    for condition in ("photos", OTHER_SCENES):
        assert [sums[quantity, condition] for quantity in (TRIALS, SCENES, FALSE_POSITIVES)] == [1, 1, 0]
