"""The graph of stages as geometry: columns from left to right, the template draws boxes and curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.stage import LineageRecord
from stages.analysis.page.figures import write_seconds

BOX_HEIGHT, GAP_ACROSS, GAP_DOWN, MARGIN = 44, 46, 14, 4
CHARACTER, LONGEST_NAME = 7.4, 26


@dataclass(frozen=True)
class Box:
    """One stage: the corner nearest the origin, its name as it fits and in full, and what it is and took."""

    x: float
    y: float
    name: str
    full_name: str
    detail: str
    private: bool


@dataclass(frozen=True)
class Graph:
    """``edges`` are SVG paths."""

    width: float
    height: float
    box_width: float
    box_height: float
    boxes: tuple[Box, ...]
    edges: tuple[str, ...]


def draw_graph(lineage: Sequence[LineageRecord]) -> Graph | None:
    """Every stage one column right of the last stage that it takes from; None for an empty lineage."""
    if not lineage:
        return None
    columns = _columns(lineage)
    longest = max(len(text) for record in lineage for text in (_shortened(record.name), _detail(record)))
    box_width = round(longest * CHARACTER + 22)
    tallest = max(map(len, columns))
    height = tallest * (BOX_HEIGHT + GAP_DOWN) - GAP_DOWN + 2 * MARGIN
    boxes = {}
    for across, column in enumerate(columns):
        top = (height - len(column) * (BOX_HEIGHT + GAP_DOWN) + GAP_DOWN) / 2
        for down, record in enumerate(column):
            x, y = MARGIN + across * (box_width + GAP_ACROSS), top + down * (BOX_HEIGHT + GAP_DOWN)
            boxes[record.name] = Box(x, y, _shortened(record.name), record.name, _detail(record), record.private)
    edges = [
        _edge(boxes[name], boxes[record.name], box_width)
        for record in lineage
        for name in dict.fromkeys(record.inputs)
        if name in boxes
    ]
    width = len(columns) * (box_width + GAP_ACROSS) - GAP_ACROSS + 2 * MARGIN
    return Graph(width, height, box_width, BOX_HEIGHT, tuple(boxes.values()), tuple(edges))


def _columns(lineage: Sequence[LineageRecord]) -> list[list[LineageRecord]]:
    """Stages by depth; within a column near to the stages that they take from, so that few curves cross."""
    depth: dict[str, int] = {}
    for record in lineage:
        depth[record.name] = 1 + max((depth[name] for name in record.inputs if name in depth), default=-1)
    columns: list[list[LineageRecord]] = [[] for _ in range(1 + max(depth.values()))]
    for record in lineage:
        columns[depth[record.name]].append(record)
    place: dict[str, float] = {}
    for column in columns:
        wanted = {record.name: _mean([place[name] for name in record.inputs if name in place]) for record in column}
        column.sort(key=lambda record: wanted[record.name])
        place |= {record.name: down - len(column) / 2 for down, record in enumerate(column)}
    return columns


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else 0


def _shortened(name: str) -> str:
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"


def _detail(record: LineageRecord) -> str:
    return f"{record.uses} · {write_seconds(record.seconds)}"


def _edge(start: Box, end: Box, box_width: float) -> str:
    x0, y0, x1, y1 = start.x + box_width, start.y + BOX_HEIGHT / 2, end.x, end.y + BOX_HEIGHT / 2
    bend = min(GAP_ACROSS, x1 - x0) * 0.55
    return f"M{x0:.1f},{y0:.1f} C{x0 + bend:.1f},{y0:.1f} {x1 - bend:.1f},{y1:.1f} {x1:.1f},{y1:.1f}"
