"""Table 1: the paper's figures of a message stand beside ours only if both are of the same scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.stage import Item
from stages.analysis.page.figures import MISSING
from stages.analysis.paper.fidelity import fidelity
from stages.analysis.paper.grid import HERE, PAPER, Grid
from stages.analysis.paper.published import read_published
from stages.analysis.paper.runs import Columns, read_study
from tests.stages.analysis.paper import synthetic

PAPERS_MESSAGES = {"fox": "counter", "bonsai": "counter", "kitchen": "bonsai"}
"""What the paper hides; fox is not among its captures and has no figures."""


def hiding(folder: Path, messages: dict[str, str], column: str | None = "message") -> Iterator[Item]:
    """The items of Table 1, hiding these messages, which stand in this column."""
    for item in synthetic.fidelity_items(folder):
        values = {name: value for name, value in item.values.items() if name != "message"}
        named = {} if column is None else {column: messages[str(values["capture"])]}
        yield replace(item, values={**values, **named})


def first_table(items: Iterator[Item], columns: Columns | None = None) -> Grid:
    paper = read_published()
    return fidelity(read_study(items, [], columns or Columns(), paper.setup), paper).grids[0]


def papers_figures(grid: Grid, picture: str) -> dict[str, str]:
    """The paper's figures of GS-Hider by heading."""
    (line,) = [line for line in grid.lines if line.names == ("GS-Hider", picture, PAPER)]
    return {heading: cell.text for heading, cell in zip(grid.headings, line.cells, strict=True)}


def test_the_papers_figure_is_shown_where_it_hides_the_same_message(tmp_path: Path) -> None:
    grid = first_table(hiding(tmp_path, {**PAPERS_MESSAGES, "bonsai": "my captures/Counter"}))
    figures = papers_figures(grid, "Message")
    assert figures["bonsai"] != MISSING
    assert figures["kitchen"] != MISSING
    assert figures["fox"] == MISSING
    assert not [note for note in grid.notes if "another picture" in note]


def test_the_papers_figure_of_another_message_is_left_out_and_that_is_said(tmp_path: Path) -> None:
    grid = first_table(hiding(tmp_path, {**PAPERS_MESSAGES, "bonsai": "kitchen"}))
    message, cover = papers_figures(grid, "Message"), papers_figures(grid, "Cover")
    assert message["bonsai"] == MISSING
    assert message["kitchen"] != MISSING
    assert cover["bonsai"] != MISSING
    (note,) = [note for note in grid.notes if "another picture" in note]
    assert "counter in bonsai" in note
    assert "kitchen" not in note


@pytest.mark.parametrize(("column", "shown"), [("secret", False), ("message", True)])
def test_the_message_is_named_by_its_column(tmp_path: Path, column: str, shown: bool) -> None:
    """Else it has the name that it was scored by, which here is bonsai, as in the paper."""
    items = hiding(tmp_path, {**PAPERS_MESSAGES, "kitchen": "counter"}, "secret")
    figures = papers_figures(first_table(items, Columns(message=column)), "Message")
    assert (figures["kitchen"] != MISSING) is shown


def test_messages_that_no_column_names_have_the_names_they_were_scored_by(tmp_path: Path) -> None:
    """The synthetic rows are of messages that are called what is hidden: the fox in bonsai, and bonsai in kitchen."""
    figures = papers_figures(first_table(hiding(tmp_path, {}, None)), "Message")
    assert figures["bonsai"] == MISSING
    assert figures["kitchen"] != MISSING


def test_sizes_that_are_not_of_all_captures_say_so(tmp_path: Path) -> None:
    """Sizes of different captures cannot be compared."""
    items = [item for item in hiding(tmp_path, PAPERS_MESSAGES) if item.values["method"] != "gs_hider"]
    items += [item for item in hiding(tmp_path / "fox", PAPERS_MESSAGES) if item.values["capture"] == "fox"]
    grid = first_table(iter(items))
    covers = {line.names[0]: line.cells[:2] for line in grid.lines if line.names[1:] == ("Cover", HERE)}
    assert {cell.note for cell in covers["GS-Hider"]} == {"on 1 capture"}
    assert {cell.note for cell in covers["3DGS+SH"]} == {""}


def test_sizes_are_said_to_be_of_arrays_and_what_files_have_besides(tmp_path: Path) -> None:
    [note] = [note for note in first_table(hiding(tmp_path, PAPERS_MESSAGES)).notes if note.startswith("Size")]
    assert "as arrays" in note
    assert "12 bytes a Gaussian more" in note
