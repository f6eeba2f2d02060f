"""The graph of stages as geometry, in columns from left to right; the template draws its boxes and curves.

A stage's output may be used many columns further right. It is carried there in a lane, a slot of its own in every
column between, which all users share, so that no curve runs behind a box.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from pipeline.stage import LineageRecord
from stages.analysis.page.figures import write_seconds

BOX_HEIGHT, LANE_HEIGHT, GAP_ACROSS, GAP_DOWN, MARGIN = 44, 4, 44, 14, 4
CHARACTER, LONGEST_NAME = 7.4, 26

Slot = tuple[str, int]
"""A stage's name and a column: the stage's box in its own column, its lane in later ones."""


@dataclass(frozen=True)
class Box:
    """One stage: its box's top left corner, its name (shortened, and in full), and its kind with the time it took."""

    x: float
    y: float
    name: str
    full_name: str
    detail: str
    private: bool


@dataclass(frozen=True)
class Graph:
    """The drawing; ``curves`` are SVG paths."""

    width: float
    height: float
    box_width: float
    box_height: float
    boxes: tuple[Box, ...]
    curves: tuple[str, ...]


def draw_graph(lineage: Sequence[LineageRecord]) -> Graph | None:
    """The drawing of a lineage, with every stage one column right of its rightmost input; None if it is empty."""
    if not lineage:
        return None
    depth = _depths(lineage)
    columns = _columns(lineage, depth)
    box_width = round(max(len(text) for record in lineage for text in _texts(record)) * CHARACTER + 22)
    height = max(_stacked(column, depth) for column in columns)
    middles = {
        slot: middle + (height - _stacked(column, depth)) / 2 + MARGIN
        for column in columns
        for slot, middle in _middles(column, depth)
    }

    def left(column: int) -> float:
        return MARGIN + column * (box_width + GAP_ACROSS)

    boxes = []
    for record in lineage:
        name, detail = _texts(record)
        column = depth[record.name]
        y = middles[record.name, column] - BOX_HEIGHT / 2
        boxes.append(Box(left(column), y, name, record.name, detail, record.private))
    curves = [
        _curve(left(start[1]) + box_width, middles[start], left(end[1]), middles[end], box_width * (start[0] == end[0]))
        for start, end in dict.fromkeys(_links(lineage, depth))
    ]
    width = left(len(columns) - 1) + box_width + MARGIN
    return Graph(width, height + 2 * MARGIN, box_width, BOX_HEIGHT, tuple(boxes), tuple(curves))


def _texts(record: LineageRecord) -> tuple[str, str]:
    name = record.name if len(record.name) <= LONGEST_NAME else f"{record.name[: LONGEST_NAME - 1]}…"
    return name, f"{record.uses} · {write_seconds(record.seconds)}"


def _depths(lineage: Sequence[LineageRecord]) -> dict[str, int]:
    depth: dict[str, int] = {}
    for record in lineage:
        depth[record.name] = 1 + max((depth[name] for name in record.inputs if name in depth), default=-1)
    return depth


def _links(lineage: Sequence[LineageRecord], depth: Mapping[str, int]) -> Iterator[tuple[Slot, Slot]]:
    """Links from a slot to one in the next column, along each lane and to its users; some occur more than once."""
    for record in lineage:
        for name in record.inputs:
            if name in depth:
                lane = [(name, column) for column in range(depth[name], depth[record.name])]
                yield from zip(lane, [*lane[1:], (record.name, depth[record.name])], strict=True)


def _columns(lineage: Sequence[LineageRecord], depth: Mapping[str, int]) -> list[list[Slot]]:
    """Boxes and lanes by column, each placed near its predecessors, so that few curves cross."""
    before: dict[Slot, list[Slot]] = {(record.name, depth[record.name]): [] for record in lineage}
    for start, end in _links(lineage, depth):
        before.setdefault(end, []).append(start)
    columns: list[list[Slot]] = [[] for _ in range(1 + max(depth.values()))]
    for slot in before:
        columns[slot[1]].append(slot)
    place: dict[Slot, float] = {}
    for column in columns:
        wanted = {slot: _mean([place[start] for start in before[slot]]) for slot in column}
        column.sort(key=wanted.__getitem__)
        place |= {slot: (down + 0.5) / len(column) for down, slot in enumerate(column)}
    return columns


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else 0


def _height(slot: Slot, depth: Mapping[str, int]) -> int:
    return BOX_HEIGHT if depth[slot[0]] == slot[1] else LANE_HEIGHT


def _stacked(column: Sequence[Slot], depth: Mapping[str, int]) -> int:
    return sum(_height(slot, depth) + GAP_DOWN for slot in column) - GAP_DOWN


def _middles(column: Sequence[Slot], depth: Mapping[str, int]) -> Iterator[tuple[Slot, float]]:
    top = 0.0
    for slot in column:
        yield slot, top + _height(slot, depth) / 2
        top += _height(slot, depth) + GAP_DOWN


def _curve(x0: float, y0: float, x1: float, y1: float, onward: float) -> str:
    """An SVG path from the right side of one column to the left of the next, continued by ``onward`` along a lane."""
    middle = (x0 + x1) / 2
    path = f"M{x0:.1f},{y0:.1f} C{middle:.1f},{y0:.1f} {middle:.1f},{y1:.1f} {x1:.1f},{y1:.1f}"
    return f"{path} h{onward:.1f}" if onward else path
