"""Line charts as geometry: the template draws them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

WIDTH, HEIGHT = 420, 260
LEFT, RIGHT, TOP, BOTTOM = 56, 24, 12, 34
SHORTEST = 8.0
"""A line whose points nearly coincide is drawn this long, to be visible."""


@dataclass(frozen=True)
class Series:
    """A named line; points are (x, y) with x ascending and finite values."""

    name: str
    points: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Tick:
    """A mark on an axis: its position in the chart's units, and its label."""

    position: float
    text: str


@dataclass(frozen=True)
class Chart:
    """A chart's geometry. ``lines`` are names with the points of an SVG polyline; ``looks`` are their colour numbers.

    ``over`` says over how many earlier lines each runs in part: it would hide them if it were not dashed. ``axes`` are
    the labels of the horizontal and the vertical axis.
    """

    title: str
    across: tuple[Tick, ...]
    upward: tuple[Tick, ...]
    lines: tuple[tuple[str, str], ...]
    looks: tuple[int, ...]
    over: tuple[int, ...]
    axes: tuple[str, str] = ("", "")
    width: int = WIDTH
    height: int = HEIGHT
    left: int = LEFT
    right: int = WIDTH - RIGHT
    top: int = TOP
    bottom: int = HEIGHT - BOTTOM


def line_chart(
    title: str,
    series: Sequence[Series],
    logarithmic: bool = False,
    from_zero: bool = True,
    axes: tuple[str, str] = ("", ""),
) -> Chart | None:
    """The chart of all series over common axes, or None if no series has a drawable point.

    If ``logarithmic``, the vertical axis is, and only positive values are drawn. ``from_zero`` starts the horizontal
    axis at 0, as for iterations, otherwise just below the smallest value. A series without points keeps its colour
    number, so that colours agree between charts.
    """
    usable = [
        Series(each.name, tuple(point for point in each.points if _drawable(point, logarithmic))) for each in series
    ]
    looks = tuple(number for number, each in enumerate(usable) if each.points)
    usable = [usable[number] for number in looks]
    if not usable:
        return None
    points = [point for each in usable for point in each.points]
    right = max(x for x, _ in points)
    left, right = (0.0, right or 1.0) if from_zero else _padded(min(x for x, _ in points), right)
    values = [math.log10(y) if logarithmic else y for _, y in points]
    low, high = _padded(min(values), max(values))

    def place(x: float, y: float) -> tuple[float, float]:
        upward = math.log10(y) if logarithmic else y
        across = LEFT + (WIDTH - LEFT - RIGHT) * (x - left) / (right - left)
        return across, TOP + (HEIGHT - TOP - BOTTOM) * (high - upward) / (high - low)

    placed = [[place(*point) for point in each.points] for each in usable]
    levels = _decade_ticks(low, high) if logarithmic else _round_ticks(low, high)
    return Chart(
        title,
        tuple(Tick(place(x, 1)[0], f"{x:,g}") for x in _round_ticks(left, right)),
        tuple(Tick(place(0, y)[1], f"{y:,g}") for y in levels),
        tuple((each.name, _polyline(line)) for each, line in zip(usable, placed, strict=True)),
        looks,
        tuple(_run_over_earlier(placed)),
        axes,
    )


def _drawable(point: tuple[float, float], logarithmic: bool) -> bool:
    return all(map(math.isfinite, point)) and (point[1] > 0 or not logarithmic)


def _padded(low: float, high: float) -> tuple[float, float]:
    """The range with a margin of 5 % at either end, or of 0.5 if tick labels could not distinguish its ends."""
    told_apart = high - low > 1e-4 * max(abs(low), abs(high))
    margin = 0.05 * (high - low) if told_apart else 0.5
    return low - margin, high + margin


def _round_ticks(low: float, high: float) -> list[float]:
    """Multiples of a step that is 1, 2 or 5 times a power of ten: two to seven of them."""
    rough = (high - low) / 5 or 1
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(step for step in (power, 2 * power, 5 * power, 10 * power) if step >= 0.8 * rough)
    first, last = math.ceil(low / step), math.floor(high / step)
    return [round(index * step, 10) for index in range(first, last + 1)]


def _decade_ticks(low: float, high: float) -> list[float]:
    """Powers of ten between two exponents, with their multiples by 2 and 5 in a short range; else round numbers."""
    steps = (1, 2, 5) if high - low < 2 else (1,)
    decades = range(math.floor(low), math.ceil(high) + 1)
    marks = [step * 10.0**decade for decade in decades for step in steps]
    inside = [mark for mark in marks if low <= math.log10(mark) <= high]
    return inside if len(inside) >= 3 else _round_ticks(10**low, 10**high)


def _run_over_earlier(lines: Iterable[Sequence[tuple[float, float]]]) -> Iterator[int]:
    """Of each line, with how many before it it has a segment, or its only point, in common, to a whole pixel."""
    drawn: list[set[tuple[tuple[int, int], tuple[int, int]]]] = []
    for line in lines:
        pixels = [(round(x), round(y)) for x, y in line]
        segments = set(pairwise(pixels)) if len(pixels) > 1 else {(pixels[0], pixels[0])}
        yield sum(not segments.isdisjoint(earlier) for earlier in drawn)
        drawn.append(segments)


def _polyline(points: Sequence[tuple[float, float]]) -> str:
    sides = [max(values) - min(values) for values in zip(*points, strict=True)]
    if math.hypot(*sides) < SHORTEST:
        x, y = points[0]
        points = ((x - SHORTEST / 2, y), (x + SHORTEST / 2, y))
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
