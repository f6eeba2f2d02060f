"""Draws a graph of stages as SVG, in layers from left to right, without any external tool.

The layout is Sugiyama's: a layer for each stage (the length of the longest path to it), a point in every layer that an
arrow passes, an order within layers that follows the neighbours, and smooth curves through the points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import Literal

Tone = Literal["plain", "done", "private", "failed"]

FILLS: Mapping[Tone, tuple[str, str]] = {
    "plain": ("#f4f5f7", "#8a94a6"),
    "done": ("#e8f3ec", "#3f8f5f"),
    "private": ("#f6ecf7", "#9a4fa3"),
    "failed": ("#fdecea", "#c0392b"),
}
LETTER, SMALL_LETTER = 9.4, 7.0  # width of a letter in the name, and in the lines below it, in the widest usual font
LINE = 15.0  # height of a line of text
PADDING = 10.0
GAP_ACROSS = 56.0  # between layers
GAP_ALONG = 16.0  # between boxes of a layer
SWEEPS = 8


@dataclass(frozen=True)
class Box:
    """A stage to be drawn: its name, the names of the stages that it takes from, and small lines below its name."""

    name: str
    inputs: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()
    tone: Tone = "plain"


@dataclass
class _Place:
    """A place in a layer: of a box, or (`box` is None) of a point that an arrow passes."""

    layer: int
    box: Box | None
    width: float
    height: float
    x: float = 0.0
    y: float = 0.0


def draw(boxes: Sequence[Box]) -> str:
    """The graph as the text of an `<svg>` element, for a file of its own or as part of a page.

    Each box must come after those that it takes from; inputs that are not among the boxes are left out. Without boxes
    the picture is empty.
    """
    names = {box.name for box in boxes}
    places, arrows = _lay_out([Box(b.name, tuple(i for i in b.inputs if i in names), b.lines, b.tone) for b in boxes])
    width = max((place.x + place.width for place in places.values()), default=0) + PADDING
    height = max((place.y + place.height for place in places.values()), default=0) + PADDING
    curves = [_curve([places[name] for name in arrow]) for arrow in arrows]
    drawn = [_drawn(place) for place in places.values() if place.box]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" '
            f'height="{height:.0f}" role="img" aria-label="The stages and their dependencies" '
            'font-family="system-ui, sans-serif">',
            '<g fill="none" stroke="#8a94a6" stroke-width="1.4">',
            *curves,
            "</g>",
            *drawn,
            "</svg>\n",
        ]
    )


def _lay_out(boxes: Sequence[Box]) -> tuple[dict[str, _Place], list[list[str]]]:
    """The place of every box and passing point, and the arrows as lists of their names."""
    places: dict[str, _Place] = {}
    arrows: list[list[str]] = []
    for box in boxes:
        layer = max((places[name].layer + 1 for name in box.inputs), default=0)
        widest = max(len(box.name) * LETTER, *(len(line) * SMALL_LETTER for line in box.lines), 40.0)
        places[box.name] = _Place(layer, box, widest + 2 * PADDING, LINE * (1 + len(box.lines)) + PADDING)
    for box in boxes:
        for name in dict.fromkeys(box.inputs):
            between = range(places[name].layer + 1, places[box.name].layer)
            passing = [f"{name} → {layer}" for layer in between]  # arrows from one box share their points
            for layer, point in zip(between, passing, strict=True):
                places.setdefault(point, _Place(layer, None, 0.0, 4.0))
            arrows.append([name, *passing, box.name])
    layers = _layers(places)
    _order(layers, arrows)
    _position(layers, places, arrows)
    return places, arrows


def _layers(places: Mapping[str, _Place]) -> list[list[str]]:
    layers: list[list[str]] = [[] for _ in range(max((place.layer for place in places.values()), default=-1) + 1)]
    for name, place in places.items():
        layers[place.layer].append(name)
    return layers


def _neighbours(arrows: Sequence[Sequence[str]]) -> tuple[dict[str, set[str]], dict[str, set[str]]]:
    before: dict[str, set[str]] = {}
    after: dict[str, set[str]] = {}
    for arrow in arrows:
        for first, second in pairwise(arrow):
            before.setdefault(second, set()).add(first)
            after.setdefault(first, set()).add(second)
    return before, after


def _order(layers: list[list[str]], arrows: Sequence[Sequence[str]]) -> None:
    """Sorts each layer by where its neighbours are, in alternating directions, so that few arrows cross."""
    before, after = _neighbours(arrows)
    for sweep in range(SWEEPS):
        forth = sweep % 2 == 0
        for index in range(len(layers)) if forth else reversed(range(len(layers))):
            beside = index - 1 if forth else index + 1
            if not 0 <= beside < len(layers):
                continue
            rank = {name: number / max(1, len(layers[beside]) - 1) for number, name in enumerate(layers[beside])}
            near = before if forth else after
            own = {name: number / max(1, len(layers[index]) - 1) for number, name in enumerate(layers[index])}
            layers[index].sort(key=lambda name: _mean([rank[n] for n in sorted(near.get(name, ()))], own[name]))


def _position(layers: list[list[str]], places: dict[str, _Place], arrows: Sequence[Sequence[str]]) -> None:
    x = PADDING
    for layer in layers:
        width = max(places[name].width for name in layer)
        y = PADDING
        for name in layer:
            place = places[name]
            place.width = width
            place.x, place.y = x, y
            y += place.height + GAP_ALONG
        x += width + GAP_ACROSS
    before, after = _neighbours(arrows)
    for sweep in range(SWEEPS):
        for layer in layers if sweep % 2 == 0 else reversed(layers):
            near = before if sweep % 2 == 0 else after
            wished = {name: _wish(places, name, near.get(name, set())) for name in layer}
            _settle([places[name] for name in layer], [wished[name] for name in layer])
    top = min((place.y for place in places.values()), default=PADDING)
    for place in places.values():
        place.y += PADDING - top


def _wish(places: Mapping[str, _Place], name: str, neighbours: set[str]) -> float:
    """The upper edge at which a place would be level with the middle of its neighbours."""
    place = places[name]
    middles = [places[other].y + places[other].height / 2 for other in sorted(neighbours)]
    return _mean(middles, place.y + place.height / 2) - place.height / 2


def _settle(layer: Sequence[_Place], wished: Sequence[float]) -> None:
    """Moves each place to where it wishes to be, as far as its neighbours leave room; conflicts are split evenly."""
    down, up = list(wished), list(wished)
    for index in range(1, len(layer)):
        down[index] = max(down[index], down[index - 1] + layer[index - 1].height + GAP_ALONG)
    for index in reversed(range(len(layer) - 1)):
        up[index] = min(up[index], up[index + 1] - layer[index].height - GAP_ALONG)
    for place, low, high in zip(layer, down, up, strict=True):
        place.y = (low + high) / 2


def _curve(way: Sequence[_Place]) -> str:
    first = way[0]
    x, y = first.x + first.width, first.y + first.height / 2
    text = f"M{x:.1f} {y:.1f}"
    for place in way[1:]:
        next_y = place.y + place.height / 2
        bend = (place.x - x) / 2
        text += f" C{x + bend:.1f} {y:.1f} {place.x - bend:.1f} {next_y:.1f} {place.x:.1f} {next_y:.1f}"
        x, y = place.x, next_y
        if place.box is None:
            x += place.width
            text += f" H{x:.1f}"
    return f'<path d="{text}"/><circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="#8a94a6" stroke="none"/>'


def _drawn(place: _Place) -> str:
    box = place.box or Box("")
    fill, edge = FILLS[box.tone]
    middle = place.x + place.width / 2
    y = place.y + PADDING / 2 + LINE * 0.75
    texts = [f'<text x="{middle:.1f}" y="{y:.1f}" font-size="13" font-weight="600">{escape(box.name)}</text>']
    for number, line in enumerate(box.lines, start=1):
        below = y + number * LINE
        texts.append(f'<text x="{middle:.1f}" y="{below:.1f}" font-size="11" fill="#566">{escape(line)}</text>')
    return (
        f'<g text-anchor="middle"><rect x="{place.x:.1f}" y="{place.y:.1f}" width="{place.width:.1f}" '
        f'height="{place.height:.1f}" rx="6" fill="{fill}" stroke="{edge}"/>{"".join(texts)}</g>'
    )


def _mean(values: Sequence[float], otherwise: float) -> float:
    return sum(values) / len(values) if values else otherwise
