"""The page as a Markdown file, to be kept in the repository."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from stages.analysis.paper.drawing import drawing_file
from stages.analysis.paper.grid import Cell, Grid
from stages.analysis.paper.page import TablesPage

SPECIAL = re.compile(r"([\\`*_\[\]<>|#&~$]|:(?=//)|(?<=www)\.)")
"""What GitHub's Markdown turns into markup, formulas or links."""


def write_markdown(page: TablesPage) -> str:
    """Title, command, tables, relations, remarks, definitions and sources; names are text, never markup.

    Charts are shown from files beside this one, with the names that `drawing_file` gives.
    """
    parts = [f"# {_text(page.title)}", _text(page.summary)]
    if page.command:
        parts.append(f"    {' '.join(page.command.split())}")
    for chapter in page.chapters:
        blocks = [block for grid in chapter.grids for block in _grid(grid)]
        parts += [f"## {_text(chapter.title)}", *(blocks or [page.nothing])]
        if chapter.charts:
            parts.append(f"![{_text(chapter.title)}]({drawing_file(chapter.title)})")
    if page.relations:
        parts += ["## What should hold", *_grid(page.relations)]
    parts += ["## How to read this", *map(_text, page.remarks)]
    parts.append("\n".join(f"- {_text(name)}: {_text(definition)}" for name, definition in page.definitions))
    if page.sources:
        parts += ["## Where the figures come from", *_grid(page.sources)]
    return "\n\n".join(parts) + "\n"


def _grid(grid: Grid) -> list[str]:
    aligned = ["---" if worded else "---:" for worded in grid.worded]
    lines = [
        _row([*grid.names, *grid.headings]),
        f"|{'|'.join([*['---'] * len(grid.names), *aligned])}|",
        *(
            _row([line.names[0] if span else "", *line.names[1:], *map(_written, line.cells)])
            for line, span in zip(grid.lines, grid.spans, strict=True)
        ),
    ]
    return [f"**{_text(grid.caption)}**", "\n".join(lines), *map(_text, grid.notes)]


def _written(cell: Cell) -> str:
    return f"{cell.text} ({cell.note})" if cell.note else cell.text


def _row(texts: Sequence[str] | Iterable[str]) -> str:
    return f"| {' | '.join(map(_text, texts))} |"


def _text(text: str) -> str:
    """One line of text, in which nothing is Markdown's markup, and no web address becomes a link."""
    return SPECIAL.sub(r"\\\1", " ".join(text.split()))
