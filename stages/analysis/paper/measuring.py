"""Figures of runs: the mean over runs that differ only in the seed, its spread, and the noise from seed to seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from scipy.stats import t as student

from stages.analysis.page.tables import Column, mean_of
from stages.analysis.paper.runs import Run
from stages.analysis.roc import CONFIDENCE

Figure = Callable[[Run], float]
"""Reads a figure off a run; NaN if it was not measured."""


@dataclass(frozen=True)
class Spread:
    """The mean of `count` values, NaN for none, and their standard deviation, NaN for fewer than two.

    `worth` is the variance of a single run from one seed to the next, divided by that of this mean: 2 for the mean of
    two runs, 1/2 for the difference of two runs.
    """

    mean: float
    deviation: float = math.nan
    count: int = 0
    worth: float = 1.0


UNKNOWN = Spread(math.nan)
"""The spread of a figure that was not measured."""


def spread_of(values: Sequence[float]) -> Spread:
    """The mean and the sample standard deviation of runs that differ only in the seed; UNKNOWN without any."""
    if not values:
        return UNKNOWN
    middle, count = mean(values), len(values)
    squares = math.fsum((value - middle) ** 2 for value in values)
    return Spread(middle, math.sqrt(squares / (count - 1)) if count > 1 else math.nan, count, count)


def together(spreads: Sequence[Spread]) -> Spread:
    """The mean of several spreads; it has a deviation if each of them has one. UNKNOWN without any.

    `count` is the smallest of theirs: each of them is the mean of at least that many values.
    """
    if len(spreads) == 1:
        return spreads[0]
    if not spreads:
        return UNKNOWN
    deviation = math.hypot(*(each.deviation for each in spreads)) / len(spreads)
    worth = len(spreads) ** 2 / sum(1 / each.worth for each in spreads)
    return Spread(mean(each.mean for each in spreads), deviation, min(each.count for each in spreads), worth)


@dataclass(frozen=True)
class Measured:
    """A figure of runs of one kind, by capture, and there by what each run hides.

    `by_message` has no capture whose runs do not say what they hide, such as those of plain 3DGS.
    """

    by_capture: Mapping[str, Spread]
    by_message: Mapping[str, Mapping[str, Spread]] = field(default_factory=dict)

    @property
    def average(self) -> Spread:
        """The mean over the captures, as by `together`."""
        return together([*self.by_capture.values()])

    def on(self, capture: str) -> float:
        """The mean on one capture; NaN where it was not measured."""
        return self.by_capture.get(capture, UNKNOWN).mean

    @property
    def certain(self) -> Measured:
        """The same figures with infinite `worth`, for what does not depend on the seed."""
        messages = {capture: _certain(spreads) for capture, spreads in self.by_message.items()}
        return Measured(_certain(self.by_capture), messages)

    def minus(self, other: Measured) -> Measured:
        """The difference on each capture that both have."""
        return self.with_other(other, lambda own, others: own - others)

    def over(self, other: Measured) -> Measured:
        """The ratio on each capture that both have, unless `other` is 0 there."""
        return self.with_other(other, lambda own, others: own / others if others else math.nan)

    def with_other(self, other: Measured, combine: Callable[[float, float], float]) -> Measured:
        """Both figures combined on each capture that both have, unless that is NaN; `worth` as of a difference.

        Where both say what they hide, only what both hid there is compared: a row that failed would otherwise leave the
        mean of two messages beside that of one.
        """
        found = {}
        for capture in [each for each in self.by_capture if each in other.by_capture]:
            own, others = self._alike(capture, other), other._alike(capture, self)
            value = combine(own.mean, others.mean)
            if not math.isnan(value):
                found[capture] = Spread(value, worth=1 / (1 / own.worth + 1 / others.worth))
        return Measured(found)

    def _alike(self, capture: str, other: Measured) -> Spread:
        """The mean on a capture over what `other` hid there, too; over all of it if either does not say."""
        own, others = (each.by_message.get(capture, {}) for each in (self, other))
        if not own or not others or own.keys() == others.keys():
            return self.by_capture[capture]
        return together([spread for message, spread in own.items() if message in others])


UNMEASURED = Measured({})
"""A figure that was measured on no capture."""


@dataclass(frozen=True)
class MeasuredErrors(Measured):
    """PSNRs in dB that are averaged as mean squared errors.

    So a capture without any error, whose PSNR is infinite, does not make the average infinite.
    """

    @property
    def average(self) -> Spread:
        """The PSNR of the mean error, without a deviation; of a single capture its own spread; UNKNOWN without any."""
        whole = super().average
        if len(self.by_capture) < 2:
            return whole
        error = mean(10 ** (-each.mean / 10) for each in self.by_capture.values())
        return replace(whole, mean=-10 * math.log10(error) if error else math.inf, deviation=math.nan)


def measure(runs: Iterable[Run], figure: Figure) -> Measured:
    """A figure of runs of one kind, on each capture where it was measured.

    The spread is over runs that differ only in the seed. Runs that also differ in something else, such as the message,
    are averaged, without a deviation. Runs that differ in nothing known, not even in the seed, count as one.
    """
    values: dict[str, dict[str, dict[tuple[str, ...], dict[str, list[float]]]]] = {}
    for run in runs:
        value = figure(run)
        if not math.isnan(value):
            groups = values.setdefault(run.capture, {}).setdefault(run.hides, {})
            groups.setdefault(run.other, {}).setdefault(run.seed, []).append(value)
    by_capture, by_message = {}, {}
    for capture, messages in values.items():
        grouped = {message: [*map(_by_seed, groups.values())] for message, groups in messages.items()}
        by_capture[capture] = _spread([group for groups in grouped.values() for group in groups])
        if all(grouped):
            by_message[capture] = {message: _spread(groups) for message, groups in grouped.items()}
    return Measured(by_capture, by_message)


def _certain(spreads: Mapping[str, Spread]) -> dict[str, Spread]:
    return {name: replace(spread, worth=math.inf) for name, spread in spreads.items()}


def _by_seed(values: Mapping[str, Sequence[float]]) -> list[float]:
    """The mean for each seed."""
    return [mean(own) for own in values.values()]


@dataclass(frozen=True)
class Noise:
    """The standard deviation from one seed to the next, NaN if unknown, estimated from `count` runs on `captures`.

    `freedom` are its degrees of freedom, infinitely many if it is not an estimate. `largest` is the deviation of what
    differed most among the kinds of runs that it was pooled from.
    """

    deviation: float = math.nan
    freedom: float = 0
    count: int = 0
    captures: tuple[str, ...] = ()
    largest: float = math.nan

    @property
    def reach(self) -> float:
        """The distance from the mean of many runs that a single run does not exceed in 95 % of cases, by Student's t.

        A deviation estimated from few runs may be far too small, which t takes into account: 1.96 deviations if it is
        exact, 2.2 with ten degrees of freedom, 4.3 with two. NaN if no deviation is known.
        """
        return self.deviation * float(student.ppf((1 + CONFIDENCE) / 2, self.freedom))


NO_NOISE = Noise()
"""Unknown noise."""


def noise(runs: Iterable[Run], figure: Figure) -> Noise:
    """Noise from one seed to the next, pooled over all groups of runs that differ only in the seed."""
    groups: dict[tuple[str, object, object], dict[str, list[float]]] = {}
    for run in runs:
        value = figure(run)
        if math.isfinite(value):
            groups.setdefault((run.capture, run.kind, run.other), {}).setdefault(run.seed, []).append(value)
    repeated = {key: _by_seed(group) for key, group in groups.items() if len(group) > 1}
    if not repeated:
        return NO_NOISE
    freedom = sum(len(group) - 1 for group in repeated.values())
    squares = {key: math.fsum((value - mean(group)) ** 2 for value in group) for key, group in repeated.items()}
    captures = tuple(dict.fromkeys(capture for capture, _, _ in repeated))
    return Noise(
        math.sqrt(math.fsum(squares.values()) / freedom),
        freedom,
        sum(map(len, repeated.values())),
        captures,
        max(math.sqrt(squares[key] / (len(group) - 1)) for key, group in repeated.items()),
    )


def mean(values: Iterable[float]) -> float:
    """The mean; NaN without values."""
    listed = list(values)
    return math.fsum(listed) / len(listed) if listed else math.nan


def cover(quantity: str, split: str | None = "test") -> Figure:
    """The mean of a quantity over the cover's views; `split` is None for what belongs to no view, such as a size."""
    return lambda run: mean_of([row for row in run.rows if row.message is None], Column(quantity, split))


def message(quantity: str, split: str | None = "test", only_legal: bool = False, number: int | None = None) -> Figure:
    """The mean of a quantity over a message's views, or only its legal ones.

    For several messages, it is the mean over them, or only that of the message at `number`, from 0.
    """
    return lambda run: mean(
        value
        for name in messages_of(run, number)
        if not math.isnan(value := of_message(run, name, quantity, split, only_legal))
    )


def messages_of(run: Run, number: int | None = None) -> tuple[str, ...]:
    """The names of all of a run's messages, or only of the one at `number`; empty if there is none."""
    return run.messages if number is None else run.messages[number : number + 1]


def of_message(run: Run, name: str, quantity: str, split: str | None = "test", only_legal: bool = False) -> float:
    """The mean of a quantity over the views of one message; NaN where it was not measured."""
    return mean_of([row for row in run.rows if row.message == name], Column(quantity, split, only_legal=only_legal))


def total_bytes(run: Run) -> float:
    """Bytes of everything that is stored, including the message decoder: the paper's size. NaN if not stated."""
    return cover("total_bytes", None)(run)


def published_bytes(run: Run) -> float:
    """Bytes of what is published: the container with the scene decoder."""
    return cover("container_bytes", None)(run)


def size(run: Run) -> float:
    """Bytes of everything that is stored or, if only that is stated, of what is published."""
    total = total_bytes(run)
    return published_bytes(run) if math.isnan(total) else total


def _spread(groups: Sequence[Sequence[float]]) -> Spread:
    if len(groups) > 1:
        worth = len(groups) ** 2 / sum(1 / len(group) for group in groups)
        return Spread(mean(mean(group) for group in groups), math.nan, len(groups), worth)
    [values] = groups
    return spread_of(values)
