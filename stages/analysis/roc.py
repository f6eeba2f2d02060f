"""Receiver operating characteristics of detectors: curves, areas under them, and confidence intervals of the areas.

Every scene has the same weight, and so do both classes within it, whatever their numbers of views, as the GS-Hider
paper mixes renders and photos in equal proportions. A curve pools scenes, as in the paper's figure. An area does not:
within a scene, views differ only in their class, and in a pool the differences between scenes, such as their lighting,
would drown that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int
from scipy.stats import norm
from scipy.stats import t as student

RUNS = 6
"""The number of runs of consecutive views that make up a resampled scene (a block bootstrap).

Neighbouring views get similar scores: StegExpose's, for 250 renders along a rig, have a correlation of 0.8 to 0.9
between neighbours, and of 0.5 to 0.6 over ten views. Views drawn one by one, or in short runs, would count as more
observations than they are. With simulated scores of correlation 0.9 (150 experiments), a nominal 95 % interval covered
71 to 72 % with 25 runs. With six runs and widening (`_widened`) it covers 93 to 95 % at a correlation of 0.9 between
neighbours, 89 to 90 % at 0.95, and 97 to 98 % if scores are independent (400 experiments of 250 views each, classes
drawn apart or in pairs, with noise of their own as large as what a pair shares or a tenth of that). Where it fails it
claims too much rather than too little: at 0.95 it lies above the truth in 7 to 11 %.
"""

CONFIDENCE = 0.95

REPEATS = 1000
"""How often scenes and their views are drawn anew for an interval."""


@dataclass(frozen=True)
class DetectorScores:
    """A detector's scores of one scene's views, in their order along the rig; NaN where it gives none.

    `positives` are the views it should detect. If `paired`, both classes come from the same cameras in the same order,
    and resampling draws the same cameras of both. Scores of several detectors on one scene, such as of several seeds,
    share the name `scene`; scores without a name belong to a scene of their own.
    """

    positives: Float64[np.ndarray, " P"]
    negatives: Float64[np.ndarray, " Q"]
    paired: bool = False
    scene: str = ""

    @property
    def usable(self) -> bool:
        """Whether each class has at least one score."""
        return not (np.isnan(self.positives).all() or np.isnan(self.negatives).all())

    @property
    def opposite(self) -> DetectorScores:
        """The scores of the inverted detector, whose area is 1 minus this one's."""
        return replace(self, positives=-self.positives, negatives=-self.negatives)


@dataclass(frozen=True)
class Area:
    """The area under a curve, or a difference of two areas, with its bootstrap interval over scenes and their views.

    All are NaN if nothing was scored.
    """

    value: float
    low: float
    high: float


UNKNOWN = Area(math.nan, math.nan, math.nan)


def roc_curve(scenes: Sequence[DetectorScores]) -> tuple[tuple[float, float], ...]:
    """(False positive rate, true positive rate) for every threshold in descending order, from (0, 0) to (1, 1).

    Scores on the same scene, such as of several seeds, share its weight. Scenes without usable scores are left out; if
    none is left, the curve is empty.
    """
    usable = _by_scene([scene for scene in scenes if scene.usable])
    if not usable:
        return ()
    values = np.concatenate([_both(scores) for own in usable for scores in own])
    rises = np.concatenate([_steps(scores) / len(own) for own in usable for scores in own]) / len(usable)
    order = np.argsort(-values, kind="stable")
    values, rises = values[order], rises[order]
    ends = np.append(values[1:] != values[:-1], True)  # equal values cross the threshold together
    points = np.cumsum(rises, axis=0)[ends]
    return ((0.0, 0.0), *((float(false), float(true)) for false, true in points))


def bootstrap_area(scores: Sequence[DetectorScores], seed: int, repeats: int = REPEATS) -> Area:
    """The mean area over scenes, each the mean over its detectors, with its 95 % interval.

    Each repeat draws scenes with replacement, one detector for each, and then runs of its views. With a single scene,
    the interval covers only the choice of views and detectors; with two or three, it says little about other scenes.
    The same seed gives the same interval.
    """
    scenes = _by_scene([each for each in scores if each.usable])
    if not scenes:
        return UNKNOWN
    areas = _mean_areas(list(chain(*scenes)), _drawn(scenes, np.random.default_rng(seed), repeats))
    return _with_interval(_mean_of_scenes(scenes), areas)


def bootstrap_excess(scores: Sequence[DetectorScores], controls: Sequence[DetectorScores], seed: int) -> Area:
    """The excess of the mean area of `scores` over that of `controls`, with its 95 % interval.

    Scores and controls correspond one to one in scene, detector and cameras, and all are usable. Each repeat draws the
    same of both, so that what they share, such as the negatives, does not count twice. Raises `ValueError` if their
    scenes or numbers of views differ.
    """
    pairs = list(zip(scores, controls, strict=True))
    if any(_views(own) != _views(control) for own, control in pairs):
        raise ValueError("controls are of other scenes or views than what they are controls for")
    scenes, of_controls = _by_scene(scores), _by_scene(controls)
    if not scenes:
        return UNKNOWN
    drawn = _drawn(scenes, np.random.default_rng(seed), REPEATS)
    areas, by_chance = (_mean_areas(list(chain(*each)), drawn) for each in (scenes, of_controls))
    return _with_interval(_mean_of_scenes(scenes) - _mean_of_scenes(of_controls), areas - by_chance)


def _views(scores: DetectorScores) -> tuple[str, int, int]:
    return scores.scene, len(scores.positives), len(scores.negatives)


def _with_interval(value: float, resampled: Float64[np.ndarray, " R"]) -> Area:
    tail = (1 - CONFIDENCE) / 2
    known = resampled[~np.isnan(resampled)]
    low, high = np.quantile(known, [tail, 1 - tail]) if len(known) else (math.nan, math.nan)
    return Area(value, float(low), float(high))


def _mean_of_scenes(scenes: Sequence[Sequence[DetectorScores]]) -> float:
    return float(np.mean([_mean_area(scene) for scene in scenes]))


def two_sided(scores: Iterable[DetectorScores]) -> list[DetectorScores]:
    """For each scene, the scores or their opposites, whichever have the larger area on it: max(a, 1 - a).

    Resampling keeps the direction, so an interval may extend below 0.5, which means that chance is not ruled out.
    Scores that are not usable are left out.
    """
    found: list[DetectorScores] = []
    for scene in _by_scene([each for each in scores if each.usable]):
        found += [each.opposite for each in scene] if is_upside_down(scene) else scene
    return found


def is_upside_down(scene: Sequence[DetectorScores]) -> bool:
    """Whether the mean area of one scene's detectors is below 0.5; False without usable scores."""
    return _mean_area([each for each in scene if each.usable]) < 0.5


def _by_scene(scores: Sequence[DetectorScores]) -> list[list[DetectorScores]]:
    found: dict[str | int, list[DetectorScores]] = {}
    for number, each in enumerate(scores):
        found.setdefault(each.scene or number, []).append(each)
    return [*found.values()]


class Counts(NamedTuple):
    """How often each view of a scene was drawn in each of R repeats."""

    positives: Int[np.ndarray, "R P"]
    negatives: Int[np.ndarray, "R Q"]


def _classes(scene: DetectorScores) -> tuple[Float64[np.ndarray, " P"], Float64[np.ndarray, " Q"]]:
    return scene.positives, scene.negatives


def _both(scene: DetectorScores) -> Float64[np.ndarray, " K"]:
    values = np.concatenate(_classes(scene))
    return values[~np.isnan(values)]


def _steps(scene: DetectorScores) -> Float64[np.ndarray, "K 2"]:
    """What each view adds to the (false positive, true positive) rates, in the order of `_both`."""
    positives, negatives = (int((~np.isnan(values)).sum()) for values in _classes(scene))
    return np.array([(0, 1 / positives)] * positives + [(1 / negatives, 0)] * negatives)


def _mean_area(scene: Sequence[DetectorScores]) -> float:
    """The mean area of the detectors of one scene; NaN if there are none."""
    return float(np.mean([_area(each) for each in scene])) if scene else math.nan


def _area(scores: DetectorScores) -> float:
    """The area of one detector on one scene, without resampling."""
    [value] = _areas(scores, Counts(*(np.ones((1, len(values)), int) for values in _classes(scores))))
    return float(value)


def _areas(scores: DetectorScores, drawn: Counts) -> Float64[np.ndarray, " R"]:
    """The Mann-Whitney area for each repeat: how often a positive exceeds a negative, with ties counting half."""
    of_positives = drawn.positives * ~np.isnan(scores.positives)
    of_negatives = drawn.negatives * ~np.isnan(scores.negatives)
    above = (scores.positives[:, None] > scores.negatives) + 0.5 * (scores.positives[:, None] == scores.negatives)
    pairs = of_positives.sum(axis=1) * of_negatives.sum(axis=1)
    with np.errstate(invalid="ignore"):  # 0 / 0 if none of the drawn views of a class was scored
        return np.asarray(((of_positives @ above) * of_negatives).sum(axis=1) / pairs)


def _mean_areas(scores: Sequence[DetectorScores], counts: Sequence[Counts]) -> Float64[np.ndarray, " R"]:
    """The mean area for each repeat, each detector weighted by how often it was drawn."""
    areas = np.stack([_widened(_areas(each, drawn), each) for each, drawn in zip(scores, counts, strict=True)])
    times = np.stack(
        [drawn.positives.sum(axis=1) / len(each.positives) for each, drawn in zip(scores, counts, strict=True)]
    )
    times = times * ~np.isnan(areas)
    with np.errstate(invalid="ignore"):
        return np.asarray((np.nan_to_num(areas) * times).sum(axis=0) / times.sum(axis=0))


def _widened(areas: Float64[np.ndarray, " R"], scores: DetectorScores) -> Float64[np.ndarray, " R"]:
    """The resampled areas of one scene, spread out about its area to correct for the small number of runs.

    Where the same runs are drawn of both classes, a run that is drawn twice counts its own pairs four times. Its views
    show the same things, and are told apart better than views of different runs, so resampled areas are too large on
    average. They are moved back by that much. Where the classes are drawn apart, there is no such bias.
    """
    value = _area(scores)
    known = areas[~np.isnan(areas)]
    middle = known.mean() if scores.paired and len(known) else value
    runs = min(_runs(len(values)) for values in _classes(scores))
    return np.clip(value + _widening(runs) * (areas - middle), 0, 1)


def _widening(runs: int) -> float:
    """A bootstrap treats n runs as the population, which shrinks its standard deviation by √((n - 1) / n), and has
    normal quantiles in place of Student's; this factor corrects both. A single run has no deviation to widen: 1.
    """
    if runs < 2:
        return 1.0
    upper = (1 + CONFIDENCE) / 2
    return float(student.ppf(upper, runs - 1) / norm.ppf(upper)) * math.sqrt(runs / (runs - 1))


def _drawn(scenes: Sequence[Sequence[DetectorScores]], generator: np.random.Generator, repeats: int) -> list[Counts]:
    """Counts for all detectors, in order. Each repeat draws as many scenes as there are, with replacement, and for each
    of them one detector and runs of its views."""
    counts = [
        [Counts(*(np.zeros((repeats, len(each)), int) for each in _classes(one))) for one in own] for own in scenes
    ]
    for _ in scenes:
        drawn = generator.integers(len(scenes), size=repeats)
        for number, own in enumerate(scenes):
            chosen = generator.integers(len(own), size=repeats)
            for detector, each in enumerate(own):
                rows = np.flatnonzero((drawn == number) & (chosen == detector))
                positives = _drawn_counts(len(each.positives), len(rows), generator)
                negatives = positives if each.paired else _drawn_counts(len(each.negatives), len(rows), generator)
                counts[number][detector].positives[rows] += positives
                counts[number][detector].negatives[rows] += negatives
    return list(chain(*counts))


def _drawn_counts(views: int, repeats: int, generator: np.random.Generator) -> Int[np.ndarray, "R V"]:
    """How often each of `views` views is drawn in each repeat: in circular runs, where the first follows the last."""
    runs, length = _runs(views), _run_length(views)
    begins = generator.integers(views, size=(repeats, runs, 1))
    chosen = ((begins + np.arange(length)) % views).reshape(repeats, runs * length)[:, :views]
    flat = (chosen + views * np.arange(repeats)[:, None]).ravel()
    return np.bincount(flat, minlength=repeats * views).reshape(repeats, views)


def _run_length(views: int) -> int:
    return max(1, round(views / RUNS))


def _runs(views: int) -> int:
    return math.ceil(views / _run_length(views))
