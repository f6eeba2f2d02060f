"""Measured attacks as curves, the message's PSNR over the cover's, and figures derived from these curves."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import methodcaller
from types import MappingProxyType
from typing import Literal

from stages.analysis.attacks.calibration import LEAST_LOSS
from stages.analysis.attacks.catalogue import ONE_COLOUR, UNATTACKED, restored
from stages.analysis.measurements import Measurement
from stages.analysis.paper.measuring import UNKNOWN, Measured, Spread, mean, spread_of, together
from stages.analysis.paper.runs import Experiment
from stages.imaging.metric_table import mean_of_known

POINTS = 5
"""Number of points of a mean curve."""

Reading = Literal["as found", "registered"]
"""How the message is read: with the secret alone, or also after the owner has registered the container with the
published one; of the two readings, the one that shows more counts."""


@dataclass(frozen=True)
class Point:
    """PSNR of cover and message, in dB, at one severity."""

    severity: float
    cover: float
    message: float


@dataclass(frozen=True)
class Curve:
    """One attack with one seed on one container; `points` are in the order of measurement, by severity."""

    unattacked: Point
    points: tuple[Point, ...]

    @property
    def publishable(self) -> tuple[Point, ...]:
        """The points at which the cover can still be rendered; at the others, its PSNR is NaN."""
        return tuple(point for point in self.points if not math.isnan(point.cover))

    @property
    def reach(self) -> float:
        """The largest loss of the cover, in dB; 0 without points."""
        return max((self.loss(point) for point in self.publishable), default=0.0)

    @property
    def gain(self) -> float:
        """The largest excess of the message's loss over the cover's, in dB: GSPure's score; NaN without points."""
        return max(
            (self.unattacked.message - point.message - self.loss(point) for point in self.publishable),
            default=math.nan,
        )

    def read_as(self, other: Curve) -> Curve:
        """This curve with the messages of `other`, another reading of the same attack; the covers are the same."""
        messages = {point.severity: point.message for point in other.points}
        read = (replace(point, message=messages[point.severity]) for point in self.points)
        return Curve(self.unattacked, tuple(read))

    def better_of(self, other: Curve) -> Curve:
        """This curve with the message of `other`, another reading of the same attack, wherever it shows more."""
        both = zip(self.points, self.read_as(other).points, strict=True)
        return Curve(self.unattacked, tuple(max(pair, key=lambda point: point.message) for pair in both))

    def loss(self, point: Point) -> float:
        """The cover's loss at a point, in dB; 0 if the attack improved it."""
        return max(0.0, self.unattacked.cover - point.cover)

    def message_left(self, most: float) -> float:
        """The message's mean PSNR over losses of the cover from 0 to `most` dB: the curve's area over its width.

        At each loss it is `message_at`. If `most` is 0, it is the message at no loss.
        """
        if most == 0:
            return self.message_at(0.0)
        area = 0.0
        for (left, high), (right, low) in pairwise(self._line):
            end = min(right, most)
            if end > left:
                area += (end - left) * (high + _between(left, high, right, low, end)) / 2
        return area / most

    def message_at(self, loss: float) -> float:
        """The message's PSNR if the attacker accepts this loss of the cover, in dB.

        Of the points that cost no more, the attacker takes the one that leaves least of the message; points are joined
        by lines. An attack that kills the message and spares the cover is a vertical drop. Beyond the last point, the
        curve is level.
        """
        return next(
            _between(left, high, right, low, loss)
            for (left, high), (right, low) in pairwise(self._line)
            if left <= loss <= right
        )

    @property
    def _line(self) -> list[tuple[float, float]]:
        """Pairs of the cover's loss and the message's PSNR, from loss 0, with what is left at no cost, to infinity."""
        free = (point.message for point in self.publishable if self.loss(point) <= LEAST_LOSS)
        lowest = min([self.unattacked.message, *free])
        line = [(0.0, lowest)]
        for loss, message in sorted((self.loss(point), point.message) for point in self.publishable):
            if loss > LEAST_LOSS:
                lowest = min(lowest, message)
                line.append((loss, lowest))
        return [*line, (math.inf, lowest)]


def _between(left: float, high: float, right: float, low: float, loss: float) -> float:
    """The line from (left, high) to (right, low) at `loss`; `low` if it is vertical or ends at infinity."""
    return low if math.isinf(right) or right == left else high + (low - high) * (loss - left) / (right - left)


@dataclass(frozen=True)
class MeanPoint:
    """Mean PSNR of cover and message, in dB, over curves at the same share of the loss that each cover reaches."""

    cover: float
    message: float


@dataclass(frozen=True)
class MeanCurve:
    """The mean of several curves: before the attack, and at equal steps from no loss to the largest of each cover."""

    unattacked: MeanPoint
    points: tuple[MeanPoint, ...]


def curves(
    experiment: Experiment, condition: str, floors: Mapping[str | None, float] = MappingProxyType({})
) -> tuple[Curve, ...]:
    """A curve for each seed; none where the attack was not measured. `floors` as in `_point`."""
    unattacked = _unattacked(experiment, floors)
    rows = [row for row in experiment.rows if row.condition == condition]
    found = []
    for seed in dict.fromkeys(row.seed for row in rows):
        own = [row for row in rows if row.seed == seed]
        steps = dict.fromkeys(row.severity for row in own)
        points = (_point([row for row in own if row.severity == each], each or 0.0, floors) for each in steps)
        found.append(Curve(unattacked, tuple(points)))
    return tuple(found)


def readings(experiment: Experiment, attack: str, reading: Reading, is_floored: bool = True) -> tuple[Curve, ...]:
    """A curve for each seed in this reading; if `is_floored`, no message counts as worse than the best single colour.

    If nothing can be registered, as after attacks on renders, messages are read as found.
    """
    floors = _floors(experiment) if is_floored else {}
    found = curves(experiment, attack, floors)
    again = curves(experiment, restored(attack), floors) if reading == "registered" else ()
    return tuple(each.better_of(other) for each, other in zip(found, again, strict=True)) if again else found


def mean_over_seeds(found: Sequence[Curve]) -> Curve:
    """The curve of the mean PSNRs of cover and message over one container's curves, at least one, at each severity.

    All seeds have the severities of the first, since an attacker chooses the severity and chance the rest. So a seed
    that costs the cover little does not shorten the curve, and is not continued beyond what was measured of it. A seed
    with which the cover can no longer be rendered does not count at that severity.
    """
    by_severity: dict[float, list[Point]] = {}
    for curve in found:
        for point in curve.publishable:
            by_severity.setdefault(point.severity, []).append(point)
    points = (
        Point(severity, mean(point.cover for point in own), mean(point.message for point in own))
        for severity, own in by_severity.items()
    )
    return Curve(found[0].unattacked, tuple(points))


def _floors(experiment: Experiment) -> dict[str | None, float]:
    """PSNR of the best single colour for each message; empty if it was not measured."""
    rows = [row for row in experiment.rows if (row.quantity, row.condition) == (ONE_COLOUR, UNATTACKED)]
    return {row.message: row.value for row in rows}


def most_to_lose(experiments: Iterable[Experiment]) -> Measured:
    """How far messages exceed the best single colour before any attack, in dB, by capture.

    If messages count as no worse than that, no attacker can gain more.
    """
    found: dict[str, list[Spread]] = {}
    for experiment in experiments:
        if floors := _floors(experiment):
            message, one_colour = _unattacked(experiment, floors).message, mean_of_known(floors.values())
            found.setdefault(experiment.capture, []).append(Spread(message - one_colour))
    return _by_capture(found)


def _unattacked(experiment: Experiment, floors: Mapping[str | None, float]) -> Point:
    return _point([row for row in experiment.rows if row.condition == UNATTACKED], 0.0, floors)


def average_curve(experiments: Iterable[Experiment], condition: str, read_as: str = "") -> MeanCurve | None:
    """The mean over captures of that over trainings, at equal shares of each cover's loss; None without curves.

    Of each container, the curve is that of `mean_over_seeds`. Severities that were calibrated by what they cost the
    cover differ between captures, so curves have no points in common, and they end at different losses. `read_as` is
    the condition of another reading of the messages, such as after registration; experiments without it are left out.
    """
    by_capture: dict[str, list[Curve]] = {}
    for experiment in experiments:
        found = curves(experiment, condition)
        if read_as:
            again = curves(experiment, read_as)
            found = tuple(each.read_as(other) for each, other in zip(found, again, strict=True)) if again else ()
        if found:
            by_capture.setdefault(experiment.capture, []).append(mean_over_seeds(found))
    if not by_capture:
        return None
    groups = [*by_capture.values()]
    is_free = all(curve.reach <= LEAST_LOSS for group in groups for curve in group)
    shares = [0.0] if is_free else [step / (POINTS - 1) for step in range(POINTS)]

    def average(figure: Callable[[Curve], float]) -> float:
        return mean(mean(map(figure, group)) for group in groups)

    def at(share: float) -> MeanPoint:
        return MeanPoint(
            average(lambda curve: curve.unattacked.cover - share * curve.reach),
            average(lambda curve: curve.message_at(share * curve.reach)),
        )

    unattacked = MeanPoint(
        average(lambda curve: curve.unattacked.cover), average(lambda curve: curve.unattacked.message)
    )
    return MeanCurve(unattacked, tuple(map(at, shares)))


def severities(experiments: Iterable[Experiment], condition: str) -> tuple[float, ...]:
    """All severities at which the attack was measured, ascending."""
    found = (each.severity for experiment in experiments for each in experiment.rows if each.condition == condition)
    return tuple(sorted({severity for severity in found if severity is not None}))


def measured(
    experiments: Iterable[Experiment],
    attack: str,
    reading: Reading,
    figure: Callable[[Curve], float],
    is_floored: bool = True,
) -> Measured:
    """A figure of each container's mean curve, by capture, as by `_of_mean`; `is_floored` as in `readings`."""
    spreads: dict[str, list[Spread]] = {}
    for experiment in experiments:
        found = _of_mean(readings(experiment, attack, reading, is_floored), figure)
        if not math.isnan(found.mean):
            spreads.setdefault(experiment.capture, []).append(found)
    return _by_capture(spreads)


def message_left(
    experiments: Iterable[Experiment], attack: str, reading: Reading, widths: Mapping[str, float]
) -> Measured:
    """What each container's mean curve leaves of the message up to its capture's width, in dB, by capture.

    `widths` must have all captures of experiments in which the attack was measured.
    """
    spreads: dict[str, list[Spread]] = {}
    for experiment in experiments:
        width = widths.get(experiment.capture, 0.0)
        found = _of_mean(readings(experiment, attack, reading), methodcaller("message_left", width))
        if not math.isnan(found.mean):
            spreads.setdefault(experiment.capture, []).append(found)
    return _by_capture(spreads)


def _of_mean(found: Sequence[Curve], figure: Callable[[Curve], float]) -> Spread:
    """A figure of the mean of one container's curves, with its deviation over the attack's seeds; NaN without curves.

    The deviation follows from how far the figure is off if each seed in turn is left out (the jackknife), since the
    severity that is worst for the message is that of the mean, not of each seed. Of a mean it is the usual one. Seeds
    with which the cover can never be rendered do not count, unless this holds for all.
    """
    own = [curve for curve in found if curve.publishable] or list(found)
    if not own:
        return UNKNOWN
    if len(own) == 1:
        return replace(spread_of([figure(own[0])]), worth=1.0)
    without = [figure(mean_over_seeds([*own[:row], *own[row + 1 :]])) for row in range(len(own))]
    middle = mean(without)
    deviation = math.sqrt((len(own) - 1) * math.fsum((value - middle) ** 2 for value in without))
    return Spread(figure(mean_over_seeds(own)), deviation, len(own))


def at_severity(
    experiments: Iterable[Experiment], condition: str, severity: float | None, message: bool, quantity: str
) -> Measured:
    """A quantity of cover or messages under a condition, by capture, with its spread over the attack's seeds."""
    spreads: dict[str, list[Spread]] = {}
    for experiment in experiments:
        values: dict[int | None, list[float]] = {}
        for row in experiment.rows:
            found = (row.condition, row.severity, row.quantity, row.message is not None)
            if found == (condition, severity, quantity, message) and not math.isnan(row.value):
                values.setdefault(row.seed, []).append(row.value)
        if values:
            spreads.setdefault(experiment.capture, []).append(spread([mean(each) for each in values.values()]))
    return _by_capture(spreads)


def _by_capture(spreads: Mapping[str, Sequence[Spread]]) -> Measured:
    """The mean over each capture's trainings; their differences do not count as spread of an attack's seeds."""
    return Measured({capture: together(each) for capture, each in spreads.items()})


def spread(values: Sequence[float]) -> Spread:
    """Mean and deviation over an attack's seeds on one container; worth one training, however many seeds there are."""
    return replace(spread_of(values), worth=1.0)


def _point(rows: Sequence[Measurement], severity: float, floors: Mapping[str | None, float]) -> Point:
    """The mean PSNRs of cover and messages; messages count as no worse than their floor, in dB, if they have one.

    Messages that no view shows anything of are left out.
    """
    found: dict[str | None, list[float]] = {}
    for row in rows:
        if row.quantity == "psnr":
            found.setdefault(row.message, []).append(row.value)
    cover = mean(found.pop(None, ()))
    shown = {name: value for name, values in found.items() if not math.isnan(value := mean(values))}
    return Point(severity, cover, mean(max(value, floors.get(name, -math.inf)) for name, value in shown.items()))
