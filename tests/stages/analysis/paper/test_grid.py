"""Tables as pages take them."""

from __future__ import annotations

from stages.analysis.page.figures import MISSING
from stages.analysis.paper.grid import Cell, Grid, Line


def test_columns_of_words_are_told_from_columns_of_figures() -> None:
    """Empty cells and dashes stand in both; a column of nothing else is as one of figures, as is one without lines."""
    cells = [("holds", "0.1", "", "0.1"), ("", "at most", MISSING, MISSING), (MISSING, "", "", "")]
    lines = tuple(Line(("name",), tuple(map(Cell, texts))) for texts in cells)
    grid = Grid("caption", ("names",), ("words", "both", "nothing", "figures"), lines)
    assert grid.worded == (True, False, False, False)
    assert Grid("caption", ("names",), ("figures",), ()).worded == (False,)
