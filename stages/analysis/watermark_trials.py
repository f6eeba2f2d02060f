"""Trials of a watermark's reader on pictures with the watermark, and on many kinds of pictures without it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.detection import (
    explained_share,
    share_reaching,
    threshold_at,
    upper_bound,
    upper_bound_by_group,
)
from stages.analysis.measurements import Measurement
from stages.imaging.distortions import DISTORTIONS, Distortion
from stages.imaging.pictures import Picture
from stages.imaging.psnr import psnr
from stages.training.decoder_tuning import resized_to

Shows = Callable[[Picture], Float[Tensor, "H W 3"]]
"""A reader of the watermark: maps an 8-bit picture with even sides to a watermark of the same size, in [0, 1]."""

PSNR_WATERMARK, PSNR_BLACK, BRIGHTNESS = "psnr_watermark", "psnr_black", "brightness"
"""Quantities of a reader's output: its PSNR to W_cop, its PSNR to black, and its mean value."""

HIGHEST_THRESHOLD = 0.9
"""Upper limit of a decoder's threshold: what explains nine tenths of the watermark always counts as one.

A decoder that is certain of every render would otherwise set a threshold that no other picture reaches, not even a
cropped render, whose watermark is slightly blurred.
"""

THRESHOLD, DETECTED, TRIALS = "threshold", "detected", "trials"
FALSE_POSITIVES, BOUND, BOUND_BY_SCENE, SCENES = "false_positives", "upper_bound", "upper_bound_by_scene", "scenes"

THRESHOLD_AT_99, DETECTED_AT_99 = "threshold_at_99", "detected_at_99"
FALSE_POSITIVES_AT_99, BOUND_AT_99 = "false_positives_at_99", "upper_bound_at_99"
BOUND_BY_SCENE_AT_99 = "upper_bound_by_scene_at_99"
"""The usual operating point of a ROC curve: the threshold that 99 % of the calibration renders reach, however high.

The share of the other clean renders that reach it is measured. It suits questions about pictures exactly as they were
rendered; no distorted render reaches it.
"""

NEGATIVES_DISTORTED, FALSE_POSITIVES_DISTORTED = "negatives_distorted", "false_positives_distorted"
"""For each distortion: the number of distorted pictures of other scenes, and the false positives among them."""

COVER_BEFORE, COVER_AFTER = "cover, before", "cover, after"
COVER_CONTROL = "cover, trained as long without the watermark"
"""Conditions of the container's own PSNR on test views."""

PRUNING, QUANTISATION, CONTAINER_NOISE = "container, pruned", "container, quantised", "container, noise on colours"
"""Conditions of renders of attacked containers."""

CONTAINER_WORDING = {
    PRUNING: "container: pruned at random, share",
    QUANTISATION: "container: quantised, bits",
    CONTAINER_NOISE: "container: noise on features or harmonics, sigma in spreads",
}

RENDERS, CLEAN_CHANNEL = "renders", "clean channel"

OTHER_SCENES, OWN_SCENE = "all of other scenes", "all of the cover without the watermark"
"""Conditions of the totals. The false positive rate is that on other scenes: the decoder was trained on photos and
clean renders of the cover itself, to show nothing for them."""


@dataclass(frozen=True)
class Shown:
    """Figures of a reader's output for one picture; `share` is the share of W_cop that it explains."""

    share: float
    psnr_watermark: float
    psnr_black: float
    brightness: float


@dataclass(frozen=True)
class Negative:
    """A picture without the watermark: its `kind`, and the `scene` it shows.

    `total` is the total in which it counts, `OTHER_SCENES` or `OWN_SCENE`. It is None for modified pictures, whose rate
    would depend on the modification. `distortion` is the one of `DISTORTIONS` that was applied to the picture, if any.
    """

    kind: str
    scene: str
    total: str | None
    distortion: Distortion | None = None


class Detector:
    """A reader `shows`, and the watermark it looks for, which is resized to the size of each picture.

    A reader that knows how much chance explains has a threshold of its own, `own_share` of the watermark, as its owner
    uses it. The paper's decoder has none, so calibration renders set its threshold.

    `seen` collects the results in the order of the calls to `look`. Results given at the start, from an interrupted
    run, answer the first calls without another look at their pictures.
    """

    def __init__(self, shows: Shows, watermark: Picture, own_share: float | None = None, seen: Sequence[Shown] = ()):
        self.shows, self.watermark, self.own_share = shows, watermark, own_share
        self.seen, self._looks = [*seen], 0

    def look(self, picture: Picture) -> Shown:
        """What the reader shows for an 8-bit picture with even sides."""
        if self._looks == len(self.seen):
            self.seen.append(self._look(picture))
        self._looks += 1
        return self.seen[self._looks - 1]

    def _look(self, picture: Picture) -> Shown:
        found = self.shows(picture)
        wanted = resized_to(picture, self.watermark)
        return Shown(
            explained_share(found.clamp(0, 1), wanted),
            psnr(found, wanted),
            psnr(found, torch.zeros_like(found)),
            float(found.clamp(0, 1).mean()),
        )


@dataclass(frozen=True)
class AttackedRenders:
    """Renders of a container after an attack of this name and severity: `renders` makes `count` of them, one by one."""

    name: str
    severity: float
    count: int
    renders: Callable[[], Iterable[Picture]]


@dataclass(frozen=True)
class Positives:
    """Renders with the watermark.

    `tests` are the scene's test views by name; `calibration` and `others` are from new cameras. The threshold is set on
    `calibration`, and everything else is measured on the rest. `attacked` are of the same container after attacks, and
    are made when their turn comes.
    """

    tests: Sequence[tuple[str, Picture]]
    calibration: Sequence[Picture]
    others: Sequence[Picture]
    attacked: Sequence[AttackedRenders] = ()

    @property
    def looked_at(self) -> int:
        """The number of looks that `trial_rows` takes at these pictures."""
        held_out = len(self.tests) + len(self.others)
        attacked = sum(each.count for each in self.attacked)
        return len(self.tests) + len(self.calibration) + (1 + len(DISTORTIONS)) * held_out + attacked


def trial_rows(
    detector: Detector,
    positives: Positives,
    negatives: Iterable[tuple[Negative, Picture]],
    seed: int,
    after_each: Callable[[], None],
) -> Iterator[Measurement]:
    """All figures of a trial: PSNR_W on test views, the threshold, detection rates, and false positives.

    Detection is measured on clean, distorted and attacked renders. Negatives yield false positives with upper bounds
    for each kind and total, and the reader's mean figures for each kind; distorted ones yield only false positives. For
    a reader without a threshold of its own, `THRESHOLD_AT_99` and its rates follow. Only one picture of `negatives`, or
    of an attacked container, is held at a time. Raises `ValueError` if such a reader has no calibration renders.
    """

    def look(picture: Picture) -> Shown:
        after_each()
        return detector.look(picture)

    for view, picture in positives.tests:
        shown = look(picture)
        for quantity, value in figures(shown).items():
            yield Measurement(quantity, value, RENDERS, view=view, split="test")
    calibration = [look(picture).share for picture in positives.calibration]
    threshold = detector.own_share
    if threshold is None:
        threshold = min(HIGHEST_THRESHOLD, threshold_at(calibration))
    yield Measurement(THRESHOLD, threshold, CLEAN_CHANNEL)
    held_out = [*(picture for _, picture in positives.tests), *positives.others]
    clean = [look(picture).share for picture in held_out]
    yield from _detected(CLEAN_CHANNEL, None, clean, threshold)
    for distortion in DISTORTIONS:
        shares = [look(picture).share for picture in _distorted(distortion, held_out, seed)]
        yield from _detected(distortion.name, distortion.severity, shares, threshold)
    for attacked in positives.attacked:
        shares = [look(picture).share for picture in attacked.renders()]
        yield from _detected(attacked.name, attacked.severity, shares, threshold)
    trials = [(each, look(picture)) for each, picture in negatives]
    yield from _negative_rows([trial for trial in trials if trial[0].distortion is None], threshold)
    yield from _distorted_rows(trials, threshold)
    if detector.own_share is None:
        yield from _rows_at_99(trials, threshold_at(calibration), clean)


def figures(shown: Shown) -> dict[str, float]:
    """The figures by quantity, without the share."""
    return {
        PSNR_WATERMARK: shown.psnr_watermark,
        PSNR_BLACK: shown.psnr_black,
        BRIGHTNESS: shown.brightness,
    }


def _distorted(distortion: Distortion, pictures: Sequence[Picture], seed: int) -> Iterator[Picture]:
    generator = np.random.default_rng(seed)
    return (distortion.apply(picture, generator) for picture in pictures)


def _detected(condition: str, severity: float | None, shares: Sequence[float], threshold: float) -> list[Measurement]:
    return [
        Measurement(DETECTED, share_reaching(shares, threshold), condition, severity),
        Measurement(TRIALS, len(shares), condition, severity),
    ]


def _negative_rows(trials: Sequence[tuple[Negative, Shown]], threshold: float) -> Iterator[Measurement]:
    for kind in dict.fromkeys(negative.kind for negative, _ in trials):
        own = [(negative, shown) for negative, shown in trials if negative.kind == kind]
        for quantity in (PSNR_WATERMARK, PSNR_BLACK, BRIGHTNESS):
            yield Measurement(quantity, float(np.mean([figures(shown)[quantity] for _, shown in own])), kind)
        yield from _bounds(kind, own, threshold)
    for total in (OWN_SCENE, OTHER_SCENES):
        yield from _bounds(total, [trial for trial in trials if trial[0].total == total], threshold)


def _distorted_rows(trials: Sequence[tuple[Negative, Shown]], threshold: float) -> Iterator[Measurement]:
    for distortion in DISTORTIONS:
        own = [trial for trial in trials if trial[0].distortion == distortion]
        if own:
            figures_of_it = {NEGATIVES_DISTORTED: len(own), FALSE_POSITIVES_DISTORTED: len(_wrong(own, threshold))}
            for quantity, value in figures_of_it.items():
                yield Measurement(quantity, value, distortion.name, distortion.severity)


def _rows_at_99(
    trials: Sequence[tuple[Negative, Shown]], threshold: float, clean: Sequence[float]
) -> Iterator[Measurement]:
    yield Measurement(THRESHOLD_AT_99, threshold, CLEAN_CHANNEL)
    yield Measurement(DETECTED_AT_99, share_reaching(clean, threshold), CLEAN_CHANNEL)
    for total in (OWN_SCENE, OTHER_SCENES):
        own = [trial for trial in trials if trial[0].total == total]
        wrong = _wrong(own, threshold)
        yield Measurement(FALSE_POSITIVES_AT_99, len(wrong), total)
        yield Measurement(BOUND_AT_99, upper_bound(len(wrong), len(own)), total)
        yield Measurement(BOUND_BY_SCENE_AT_99, upper_bound_by_group(_scenes(own), wrong), total)


def _wrong(trials: Sequence[tuple[Negative, Shown]], threshold: float) -> list[int]:
    """Positions of the false positives."""
    return [position for position, (_, shown) in enumerate(trials) if shown.share >= threshold]


def _scenes(trials: Sequence[tuple[Negative, Shown]]) -> list[str]:
    return [negative.scene for negative, _ in trials]


def _bounds(condition: str, trials: Sequence[tuple[Negative, Shown]], threshold: float) -> list[Measurement]:
    wrong, scenes = _wrong(trials, threshold), _scenes(trials)
    return [
        Measurement(TRIALS, len(trials), condition),
        Measurement(SCENES, len(set(scenes)), condition),
        Measurement(FALSE_POSITIVES, len(wrong), condition),
        Measurement(BOUND, upper_bound(len(wrong), len(trials)), condition),
        Measurement(BOUND_BY_SCENE, upper_bound_by_group(scenes, wrong), condition),
    ]
