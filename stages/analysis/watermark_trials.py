"""What readers of a watermark are tried on: pictures with the watermark, and pictures of many kinds without."""

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
from stages.imaging.pictures import Picture, picture_to_tensor, resize_picture
from stages.imaging.psnr import psnr

Shows = Callable[[Picture], Float[Tensor, "H W 3"]]
"""What a reader of the watermark makes of an 8-bit picture with even sides, of its size, in [0, 1]."""

PSNR_WATERMARK, PSNR_BLACK, BRIGHTNESS = "psnr_watermark", "psnr_black", "brightness"
"""Of what is shown: beside W_cop, beside black, and its mean value."""

HIGHEST_THRESHOLD = 0.9
"""A decoder that is sure of every render would set a threshold that no other picture reaches, be it a cropped render,
whose watermark is a little blurred; what explains nine tenths of the watermark counts as one, whatever renders show."""

THRESHOLD, DETECTED, TRIALS = "threshold", "detected", "trials"
FALSE_POSITIVES, BOUND, BOUND_BY_SCENE, SCENES = "false_positives", "upper_bound", "upper_bound_by_scene", "scenes"

THRESHOLD_AT_99, DETECTED_AT_99 = "threshold_at_99", "detected_at_99"
FALSE_POSITIVES_AT_99, BOUND_AT_99 = "false_positives_at_99", "upper_bound_at_99"
BOUND_BY_SCENE_AT_99 = "upper_bound_by_scene_at_99"
"""The usual point of a ROC curve: by the threshold that 99 % of the renders reach that set it, however high it is; how
many of the other clean renders reach it is measured. Whoever is asked about pictures as they were rendered may have
that one; no distorted render reaches it."""

NEGATIVES_DISTORTED, FALSE_POSITIVES_DISTORTED = "negatives_distorted", "false_positives_distorted"
"""Of each distortion: how many pictures of other scenes were tried after it, and how many of them are wrong."""

COVER_BEFORE, COVER_AFTER = "cover, before", "cover, after"
COVER_CONTROL = "cover, trained as long without the watermark"
"""Conditions of the container's own PSNR on test views."""

PRUNING, QUANTISATION, NOISE = "container, pruned", "container, quantised", "container, noise on colours"
"""Conditions of renders of attacked containers."""

CONTAINER_WORDING = {
    PRUNING: "container: pruned at random, share",
    QUANTISATION: "container: quantised, bits",
    NOISE: "container: noise on features or harmonics, sigma in spreads",
}

RENDERS, CLEAN_CHANNEL = "renders", "clean channel"

OTHER_SCENES, OWN_SCENE = "all of other scenes", "all of the cover without the watermark"
"""Conditions of the sums. The rate of false positives is that of other scenes: of the cover itself, a decoder has seen
photos and clean renders, and learnt to show nothing for them."""


@dataclass(frozen=True)
class Shown:
    """What the decoder shows of one picture: the share of W_cop that it explains, and figures of it."""

    share: float
    psnr_watermark: float
    psnr_black: float
    brightness: float


@dataclass(frozen=True)
class Negative:
    """What a picture without the watermark is: `kind` is what sort of picture, `scene` what it shows.

    `total` is the sum that it is counted in, `OTHER_SCENES` or `OWN_SCENE`; None for what is no picture as it came: a
    rate of such would be one of whatever was done to them. `distortion`: after which one of `DISTORTIONS` it is tried.
    """

    kind: str
    scene: str
    total: str | None
    distortion: Distortion | None = None


class Detector:
    """A reader, and the watermark it looks for, at the size of the container's pictures; other sizes stretch it.

    A reader that knows what chance explains has a threshold of its own, `own_share` of the watermark, and finds what
    its owner would; the paper's decoder knows nothing of that, and renders set its threshold.

    `seen` is all that was seen so far, in the order of the looks. Where some of it is given, the first looks are those
    from before, and their pictures are not looked at again.
    """

    def __init__(self, shows: Shows, watermark: Picture, own_share: float | None = None, seen: Sequence[Shown] = ()):
        self.shows, self.watermark, self.own_share = shows, watermark, own_share
        self.seen, self._looks = [*seen], 0

    def look(self, picture: Picture) -> Shown:
        """Of an 8-bit picture with even sides."""
        if self._looks == len(self.seen):
            self.seen.append(self._look(picture))
        self._looks += 1
        return self.seen[self._looks - 1]

    def _look(self, picture: Picture) -> Shown:
        found = self.shows(picture)
        wanted = stretched(self.watermark, picture)
        return Shown(
            explained_share(found.clamp(0, 1), wanted),
            psnr(found, wanted),
            psnr(found, torch.zeros_like(found)),
            float(found.clamp(0, 1).mean()),
        )


def stretched(watermark: Picture, picture: Picture) -> Float[Tensor, "H W 3"]:
    """The watermark at the size of a picture, in [0, 1]."""
    return picture_to_tensor(resize_picture(watermark, picture.shape[1], picture.shape[0]))


@dataclass(frozen=True)
class Positives:
    """Renders with the watermark: `tests` of the scene's test views by their names, `calibration` and `others` of new
    cameras. A threshold is set on `calibration`, and all else measured on the rest. `attacked`: renders of the same
    container after an attack on it, whose name and severity stand before them."""

    tests: Sequence[tuple[str, Picture]]
    calibration: Sequence[Picture]
    others: Sequence[Picture]
    attacked: Sequence[tuple[str, float, Sequence[Picture]]] = ()

    @property
    def looked_at(self) -> int:
        """How often `trial_rows` looks at any of them."""
        held_out = len(self.tests) + len(self.others)
        attacked = sum(len(pictures) for _, _, pictures in self.attacked)
        return len(self.tests) + len(self.calibration) + (1 + len(DISTORTIONS)) * held_out + attacked


def trial_rows(
    detector: Detector,
    positives: Positives,
    negatives: Iterable[tuple[Negative, Picture]],
    seed: int,
    after_each: Callable[[], None],
) -> Iterator[Measurement]:
    """PSNR_W on test views, the threshold, survival of distortions, and what is shown of every kind of negative.

    Of negatives after a distortion only how many are taken for the watermark. And, of a reader that has no threshold of
    its own, how many other clean renders it finds, and how many negatives it takes for the watermark, by the one that
    99 % of the calibration's renders reach, however high that is. Of `negatives` only one picture is held at a time.
    Raises `ValueError` without renders.
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
    for name, severity, pictures in positives.attacked:
        yield from _detected(name, severity, [look(picture).share for picture in pictures], threshold)
    trials = [(each, look(picture)) for each, picture in negatives]
    yield from _negative_rows([trial for trial in trials if trial[0].distortion is None], threshold)
    yield from _distorted_rows(trials, threshold)
    if detector.own_share is None:
        yield from _rows_at_99(trials, threshold_at(calibration), clean)


def figures(shown: Shown) -> dict[str, float]:
    """By quantity."""
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
    """Positions of those that are taken for the watermark."""
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
