"""A chapter's charts in one SVG file, for the Markdown file: repositories do not display pages of HTML."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap

from stages.analysis.page.chart import HEIGHT, WIDTH, Chart
from stages.analysis.page.html import fill, templates_beside

RESOURCES = ("templates/*",)
TEMPLATES = templates_beside(__file__)

COLUMNS, GAP = 3, 24
ABOVE, TITLE_LINE, BELOW, LEGEND_LINE = 22, 18, 24, 18
"""Heights above a chart: of its vertical axis's name, and of each line of its title; below it: of its horizontal axis's
name, and of each entry of its legend."""

TITLE_LENGTH = 46
"""Characters that fit above a chart, whichever font a browser has."""


@dataclass(frozen=True)
class Panel:
    """A chart, the lines of its title, and the upper left corner of the area that it takes with all its texts."""

    chart: Chart
    title: tuple[str, ...]
    x: int
    y: int


@dataclass(frozen=True)
class Drawing:
    """Charts in rows of three, each row as high as its longest legend requires; in the charts' units."""

    title: str
    panels: tuple[Panel, ...]
    width: int
    height: int
    above: int

    def legend_at(self, line: int) -> int:
        """The vertical position of a legend's line, from the top of its panel."""
        return self.above + _legend_beneath(line)

    @staticmethod
    def title_at(line: int) -> int:
        """The vertical position of a title's line, from the top of its panel."""
        return TITLE_LINE * (line + 1) - 2


def drawing_file(title: str) -> str:
    """The name of the file with the charts of the chapter with this title."""
    return f"{re.sub(r'[^a-z0-9]+', '_', title.lower()).strip('_')}.svg"


def write_drawing(title: str, charts: Sequence[Chart]) -> str:
    """The charts, at least one, as self-contained SVG."""
    titles = [tuple(wrap(chart.title, TITLE_LENGTH)) for chart in charts]
    above = ABOVE + TITLE_LINE * max(map(len, titles))
    panels, y = [], GAP
    for first in range(0, len(charts), COLUMNS):
        row = charts[first : first + COLUMNS]
        for place, chart in enumerate(row):
            panels.append(Panel(chart, titles[first + place], GAP + place * (WIDTH + GAP), y))
        y += above + _legend_beneath(max(len(chart.lines) for chart in row)) + GAP
    width = GAP + min(COLUMNS, len(charts)) * (WIDTH + GAP)
    return fill("charts.svg", Drawing(title, tuple(panels), width, y, above), TEMPLATES)


def _legend_beneath(line: int) -> int:
    """The vertical position of a legend's line, from the top of its chart."""
    return HEIGHT + BELOW + LEGEND_LINE * line + LEGEND_LINE // 2
