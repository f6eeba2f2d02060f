"""Names of captures and messages are text: they read as they were written."""

from __future__ import annotations

import pytest

from stages.analysis.paper.grid import Cell, Grid, Line
from stages.analysis.paper.markdown import write_markdown
from stages.analysis.paper.page import TablesPage


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("~~fox~~", r"\~\~fox\~\~"),
        ("$x_1$", r"\$x\_1\$"),
        ("https://a.example/b", r"https\://a.example/b"),
        ("www.a.example", r"www\.a.example"),
        ("a|b <i>", r"a\|b \<i\>"),
        ("λ = 0.1: 3,000 iterations", "λ = 0.1: 3,000 iterations"),
    ],
)
def test_nothing_in_a_name_is_markup(name: str, written: str) -> None:
    grid = Grid("caption", ("Capture",), ("Figure",), (Line((name,), (Cell("1.0"),)),))
    page = TablesPage(name, "", (), (), grid, (), (), None, "")
    text = write_markdown(page)
    assert text.startswith(f"# {written}\n")
    assert f"| {written} | 1.0 |" in text
