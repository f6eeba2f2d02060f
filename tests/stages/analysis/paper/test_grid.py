"""Tables as pages use them."""

from __future__ import annotations

from stages.analysis.page.figures import MISSING
from stages.analysis.paper.grid import Cell, Grid, Line


def test_columns_of_words_are_told_from_columns_of_figures() -> None:
    """Both may have empty cells and dashes; a column of nothing else, or without lines, counts as figures."""
    cells = [("holds", "0.1", "", "0.1"), ("", "at most", MISSING, MISSING), (MISSING, "", "", "")]
    lines = tuple(Line(("name",), tuple(map(Cell, texts))) for texts in cells)
    grid = Grid("caption", ("names",), ("words", "both", "nothing", "figures"), lines)
    assert grid.worded == (True, False, False, False)
    assert Grid("caption", ("names",), ("figures",), ()).worded == (False,)
