"""A chapter's charts in one SVG file, which the Markdown file shows: a repository shows no pages of HTML."""

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
"""Over a chart the lines of its title and what is upward; under it what is across, and a line for each name."""

TITLE_LENGTH = 46
"""Characters that fit over a chart, in whatever letters a browser has."""


@dataclass(frozen=True)
class Panel:
    """A chart with the lines of its title, and the corner nearest the origin of the place that it has with all that is
    written around it."""

    chart: Chart
    title: tuple[str, ...]
    x: int
    y: int


@dataclass(frozen=True)
class Drawing:
    """Charts in rows of three, each row as high as its longest legend asks for; in the charts' units."""

    title: str
    panels: tuple[Panel, ...]
    width: int
    height: int
    above: int

    def legend_at(self, line: int) -> int:
        """Where the line of a legend stands, beneath the top of its panel."""
        return self.above + _legend_beneath(line)

    @staticmethod
    def title_at(line: int) -> int:
        """Where the line of a title stands, beneath the top of its panel."""
        return TITLE_LINE * (line + 1) - 2


def drawing_file(title: str) -> str:
    """The name of the file that holds the charts of a chapter with this title."""
    return f"{re.sub(r'[^a-z0-9]+', '_', title.lower()).strip('_')}.svg"


def write_drawing(title: str, charts: Sequence[Chart]) -> str:
    """The charts as SVG, complete in itself; at least one."""
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
    """Where the line of a legend stands, beneath the top of its chart."""
    return HEIGHT + BELOW + LEGEND_LINE * line + LEGEND_LINE // 2
