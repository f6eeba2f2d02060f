"""Attacks as they were measured: what is left of the message over what is left of the cover, and figures of that."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Literal

from stages.analysis.attacks.catalogue import ONE_COLOUR, UNATTACKED, restored
from stages.analysis.measurements import Measurement
from stages.analysis.paper.measuring import Measured, Spread, mean, together
from stages.analysis.paper.runs import Experiment

LEAST_LOSS = 0.05
"""In dB of the cover: what costs it no more than this costs it nothing."""

Reading = Literal["as found", "registered"]
"""Of the message: by the secret alone, or after the owner has registered the container with what he published, and then
whichever of the two shows more."""


@dataclass(frozen=True)
class Point:
    """PSNR of cover and message, in dB, at one severity."""

    severity: float
    cover: float
    message: float


@dataclass(frozen=True)
class Curve:
    """One attack with one seed on one container: `points` in the order in which they were measured, by severity."""

    unattacked: Point
    points: tuple[Point, ...]

    @property
    def reach(self) -> float:
        """The largest loss of the cover, in dB; not negative."""
        return max((self.loss(point) for point in self.points), default=0.0)

    @property
    def gain(self) -> float:
        """The most that the message loses beyond what the cover does, in dB: what GSPure is scored by."""
        return max(
            (self.unattacked.message - point.message - self.loss(point) for point in self.points), default=math.nan
        )

    def better_of(self, other: Curve) -> Curve:
        """With the message of `other`, the same attack read otherwise, at each severity at which that shows more."""
        messages = {point.severity: point.message for point in other.points}
        best = (replace(point, message=max(point.message, messages[point.severity])) for point in self.points)
        return Curve(self.unattacked, tuple(best))

    def loss(self, point: Point) -> float:
        """What the cover loses, in dB; an attack that improves it costs nothing."""
        return max(0.0, self.unattacked.cover - point.cover)

    def message_left(self, most: float) -> float:
        """The message's PSNR, averaged over losses of the cover from 0 to `most` dB: the area under the curve, over its
        width.

        At every loss an attacker takes the point, of those that cost no more, that leaves least of the message; between
        points the line. What kills the message and spares the cover counts over the whole width. Beyond the last point
        the curve goes on level. Of no more width than `LEAST_LOSS`, what is left for nothing.
        """
        free = (point.message for point in self.points if self.loss(point) <= LEAST_LOSS)
        lowest = min([self.unattacked.message, *free])
        if most <= LEAST_LOSS:
            return lowest
        line = [(0.0, lowest)]
        for loss, message in sorted((self.loss(point), point.message) for point in self.points):
            if loss > LEAST_LOSS:
                lowest = min(lowest, message)
                line.append((loss, lowest))
        line.append((math.inf, lowest))
        area = 0.0
        for (left, high), (right, low) in pairwise(line):
            end = min(right, most)
            if end > left:
                at_end = low if math.isinf(right) else high + (low - high) * (end - left) / (right - left)
                area += (end - left) * (high + at_end) / 2
        return area / most


def curves(
    experiment: Experiment, condition: str, floors: Mapping[str | None, float] = MappingProxyType({})
) -> tuple[Curve, ...]:
    """A curve for each seed; none where the attack was not measured. `floors` as in `_point`."""
    unattacked = _unattacked(experiment, floors)
    rows = [row for row in experiment.rows if row.condition == condition]
    found = []
    for seed in dict.fromkeys(row.seed for row in rows):
        own = [row for row in rows if row.seed == seed]
        severities = dict.fromkeys(row.severity for row in own)
        points = (_point([row for row in own if row.severity == each], each or 0.0, floors) for each in severities)
        found.append(Curve(unattacked, tuple(points)))
    return tuple(found)


def readings(experiment: Experiment, attack: str, reading: Reading, is_floored: bool = True) -> tuple[Curve, ...]:
    """A curve for each seed as the messages are read; where `is_floored` none worse than a picture of one colour.

    Where nothing is to be registered, such as a render, the message is read as it was found.
    """
    floors = _floors(experiment) if is_floored else {}
    found = curves(experiment, attack, floors)
    again = curves(experiment, restored(attack), floors) if reading == "registered" else ()
    return tuple(each.better_of(other) for each, other in zip(found, again, strict=True)) if again else found


def _floors(experiment: Experiment) -> dict[str | None, float]:
    """The PSNR of a picture of one colour for each message; none of what was measured without."""
    rows = [row for row in experiment.rows if (row.quantity, row.condition) == (ONE_COLOUR, UNATTACKED)]
    return {row.message: row.value for row in rows}


def most_to_lose(experiments: Iterable[Experiment]) -> Measured:
    """How far messages are above a picture of one colour before any attack, in dB, by capture.

    Of messages that are none worse than such a picture nothing can be taken beyond this.
    """
    found: dict[str, list[Spread]] = {}
    for experiment in experiments:
        if floors := _floors(experiment):
            message = _unattacked(experiment, floors).message
            found.setdefault(experiment.capture, []).append(Spread(message - mean(floors.values())))
    return _by_capture(found)


def _unattacked(experiment: Experiment, floors: Mapping[str | None, float]) -> Point:
    return _point([row for row in experiment.rows if row.condition == UNATTACKED], 0.0, floors)


def average_curve(experiments: Iterable[Experiment], condition: str) -> Curve | None:
    """The mean over captures of the mean over seeds and trainings, point by point; of as many points as all have. None
    without any.
    """
    by_capture: dict[str, list[Curve]] = {}
    for experiment in experiments:
        by_capture.setdefault(experiment.capture, []).extend(curves(experiment, condition))
    every = [_mean_curve(found) for found in by_capture.values() if found]
    return _mean_curve(every) if every else None


def measured(
    experiments: Iterable[Experiment],
    attack: str,
    reading: Reading,
    figure: Callable[[Curve], float],
    is_floored: bool = True,
) -> Measured:
    """A figure of curves by capture, with its spread over the attack's seeds; `is_floored` as in `readings`."""
    spreads: dict[str, list[Spread]] = {}
    for experiment in experiments:
        found = [figure(curve) for curve in readings(experiment, attack, reading, is_floored)]
        known = [value for value in found if not math.isnan(value)]
        if known:
            spreads.setdefault(experiment.capture, []).append(spread(known))
    return _by_capture(spreads)


def at_severity(
    experiments: Iterable[Experiment], condition: str, severity: float | None, message: bool, quantity: str
) -> Measured:
    """A quantity of cover or messages under a condition by capture, with its spread over the attack's seeds."""
    spreads: dict[str, list[Spread]] = {}
    for experiment in experiments:
        values: dict[int | None, list[float]] = {}
        for row in experiment.rows:
            found = (row.condition, row.severity, row.quantity, row.message is not None)
            if found == (condition, severity, quantity, message):
                values.setdefault(row.seed, []).append(row.value)
        if values:
            spreads.setdefault(experiment.capture, []).append(spread([mean(each) for each in values.values()]))
    return _by_capture(spreads)


def _by_capture(spreads: Mapping[str, Sequence[Spread]]) -> Measured:
    """Of several trainings of a capture the mean: how far they lie apart is no spread of an attack's seeds."""
    return Measured({capture: together(each) for capture, each in spreads.items()})


def spread(values: Sequence[float]) -> Spread:
    """The mean and the standard deviation, NaN for fewer than two values."""
    middle = mean(values)
    if len(values) < 2:
        return Spread(middle, math.nan, len(values))
    squares = math.fsum((value - middle) ** 2 for value in values)
    return Spread(middle, math.sqrt(squares / (len(values) - 1)), len(values))


def _point(rows: Sequence[Measurement], severity: float, floors: Mapping[str | None, float]) -> Point:
    """The mean of the messages, each no worse than its floor in dB where it has one."""
    found: dict[str | None, list[float]] = {}
    for row in rows:
        if row.quantity == "psnr":
            found.setdefault(row.message, []).append(row.value)
    cover = mean(found.pop(None, ()))
    messages = (max(mean(values), floors.get(name, -math.inf)) for name, values in found.items())
    return Point(severity, cover, mean(messages))


def _mean_curve(every: Sequence[Curve]) -> Curve:
    points = zip(*(curve.points for curve in every), strict=False)
    return Curve(_mean([curve.unattacked for curve in every]), tuple(map(_mean, points)))


def _mean(points: Sequence[Point]) -> Point:
    return Point(
        mean(point.severity for point in points),
        mean(point.cover for point in points),
        mean(point.message for point in points),
    )
