"""Relations that the paper's tables show, or that this project requires: our figure, the paper's, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from stages.analysis.page.figures import MISSING
from stages.analysis.paper.grid import AVERAGE, Cell, Grid, Line
from stages.analysis.paper.measuring import NO_NOISE, UNMEASURED, Measured, Noise, Spread
from stages.analysis.paper.runs import capture_title

MOST_OVER_ONE_COLOUR = 1.0
"""In dB: how much better a reader without the secret, or features without a message, may show the message than the best
single colour does, which needs no container."""


@dataclass(frozen=True)
class Relation:
    """A difference in dB, a ratio, or a figure in dB that should be on one side of `bound`.

    `published` is the paper's figure, or that of the `source`; NaN if there is none. `noise` is that of a single run
    from one seed to the next; the noise of the average follows from the number of runs it is made of.
    """

    text: str
    kind: Literal["difference", "ratio", "figure"]
    sense: Literal["more than", "at least", "less than", "at most"]
    bound: float
    measured: Measured
    published: float = math.nan
    noise: Noise = NO_NOISE
    source: str = ""

    def holds(self, value: float) -> bool:
        """Whether a value is on the required side of the bound."""
        return {
            "more than": value > self.bound,
            "at least": value >= self.bound,
            "less than": value < self.bound,
            "at most": value <= self.bound,
        }[self.sense]

    @property
    def value(self) -> float:
        """The average over the captures; NaN where nothing was measured."""
        return self.measured.average.mean

    def figure(self, capture: str | None) -> float:
        """The figure on one capture, or the average for None; NaN if it was not measured."""
        return self.value if capture is None else self.measured.on(capture)

    def beside(self, capture: str | None) -> str:
        """A note beside that figure; none here."""
        return ""

    @property
    def captures_that_agree(self) -> int:
        """The number of captures on which it holds by itself."""
        return sum(self.holds(spread.mean) for spread in self.measured.by_capture.values())

    @property
    def is_found(self) -> bool:
        """Whether it holds on average and on at least half of the captures: a single capture can carry an average."""
        return self.holds(self.value) and 2 * self.captures_that_agree >= len(self.measured.by_capture)

    @property
    def within_noise(self) -> bool:
        """Whether other seeds could well change the verdict."""
        return abs(self.value - self.bound) < self.noise.reach / math.sqrt(self.measured.average.worth)

    @property
    def verdict(self) -> str:
        """In words, whether it holds on average over the captures, and on how many of them."""
        captures, count = len(self.measured.by_capture), self.captures_that_agree
        if not captures:
            return "not measured"
        on_average = "holds only on average" if self.holds(self.value) else "does not hold"
        words = ", ".join(["holds" if self.is_found else on_average, *(["within noise"] if self.within_noise else [])])
        if not 0 < count < captures:
            return words
        some = f"on {count} of {captures} captures"
        return f"{words}, {some}" if self.is_found else f"{words} (individually {some})"


@dataclass(frozen=True)
class OnEachCapture(Relation):
    """A requirement of security: what is found out on one capture is not secure, whatever the average is."""

    @property
    def is_found(self) -> bool:
        """Whether it holds on every capture, of which there must be at least one."""
        return 0 < self.captures_that_agree == len(self.measured.by_capture)

    @property
    def within_noise(self) -> bool:
        """Whether another seed could well change the verdict, which is that of the worst capture."""
        sign = 1 if self.sense in ("at most", "less than") else -1
        worst = max(self.measured.by_capture.values(), key=lambda each: sign * each.mean)
        return abs(worst.mean - self.bound) < self.noise.reach / math.sqrt(worst.worth)


@dataclass(frozen=True)
class TwiceCounted(Relation):
    """A relation of rates, counted by picture (`measured`) and by scene (`by_scene`), that must hold by both counts.

    Pictures of one scene resemble each other, so few scenes say little, however many pictures they have.
    """

    by_scene: Measured = UNMEASURED

    @property
    def is_found(self) -> bool:
        """Whether it holds by both counts."""
        return all(count.is_found for count in self._counts)

    @property
    def verdict(self) -> str:
        """The verdicts by both counts, or only one if they are the same."""
        by_picture, by_scene = (count.verdict for count in self._counts)
        return by_picture if by_picture == by_scene else f"by picture: {by_picture}; by scene: {by_scene}"

    def beside(self, capture: str | None) -> str:
        """The figure by scene."""
        return f"by scene {_written(self, self._counts[1].figure(capture))}"

    @property
    def _counts(self) -> tuple[Relation, Relation]:
        by_picture, by_scene = (
            Relation(self.text, self.kind, self.sense, self.bound, measured)
            for measured in (self.measured, self.by_scene)
        )
        return by_picture, by_scene


def relations_grid(relations: Sequence[tuple[str, Relation]], captures: Sequence[str]) -> Grid:
    """A line for each relation, in order, under the title of its subject."""
    return Grid(
        "Relations on test views",
        ("About", "Relation"),
        ("Required", *map(capture_title, captures), AVERAGE, "Paper", "Verdict"),
        tuple(
            Line(
                (title, each.text),
                (
                    Cell(f"{each.sense} {_written(each, each.bound, '')}"),
                    *(_cell(each, capture) for capture in (*captures, None)),
                    Cell(_published(each), each.source, Spread(each.published)),
                    Cell(each.verdict),
                ),
            )
            for title, each in relations
        ),
    )


def _cell(relation: Relation, capture: str | None) -> Cell:
    figure = relation.figure(capture)
    return Cell(_written(relation, figure), relation.beside(capture), Spread(figure))


def _published(relation: Relation) -> str:
    """The figure with the paper's digits; for NaN, `MISSING`, or nothing if the relation has a `source`."""
    if math.isnan(relation.published):
        return "" if relation.source else MISSING
    if relation.kind == "ratio":
        return f"{relation.published:.3f}"
    return f"{relation.published:{'+' if relation.kind == 'difference' else ''}.3f} dB"


def _written(relation: Relation, value: float, plus: str = "+") -> str:
    if math.isnan(value):
        return MISSING
    if relation.kind == "ratio":
        return f"{value:.2f}"
    sign = plus if relation.kind == "difference" and round(value, 2) > 0 else ""
    return f"{sign}{round(value, 2) + 0.0:.2f} dB"
