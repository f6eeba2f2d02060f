"""Rows from CSV files: every mistake is reported with its place, what was found and what is allowed."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import Place
from pipeline.workflow.located import Problems
from pipeline.workflow.table import read_table
from tests.pipeline.helpers import Workspace

EACH = """\
    stages:
      each: {uses: numbers, foreach: rows.csv, with: {first: "${item.first}", note: "${item.note}"}}
    """
NAMES = st.lists(st.from_regex(r"[A-Za-z_][A-Za-z0-9_-]{0,8}", fullmatch=True), min_size=1, max_size=4, unique=True)
TEXT = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"], include_characters="\n\t"), max_size=12)


def read(path: Path, content: bytes) -> tuple[list[dict[str, object]] | None, Problems]:
    path.write_bytes(content)
    problems = Problems()
    rows = read_table(path, Place("workflow.yaml", 1, 1), problems)
    return (None if rows is None else [dict(row.plain) for row in rows]), problems  # type: ignore[arg-type,call-overload]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "1:1: the table is empty; expected a first row with the column names, such as cover,message"),
        (b"\n \n", "1:1: the table is empty"),
        (b"first,note\n", "1:1: the table has no rows; expected at least one below the column names"),
        (b"first,note\n1,a\n2\n", "3:1: this row has 1 cell; expected 2 (first, note)"),
        (
            b"first,note\n1,a,b\n",
            "2:5: this row has 3 cells; expected 2 (first, note); a cell with a comma needs quotes",
        ),
        (b"first, first\n1,2\n", "1:8: the column 'first' appears twice; give each column its own name"),
        (b"first,\n1,2\n", "1:7: '' cannot name a column; expected letters, digits, '_' and '-'"),
        (
            b"first;note\n1;a;b\n",
            "2:5: this row has 3 cells; expected 2 (first, note); a cell with a semicolon needs quotes",
        ),
        (b"first,note|x\n1,2\n", "1:7: 'note|x' cannot name a column; expected letters, digits, '_' and '-'; separate"),
        (b"1,a\n2,b\n", "1:1: the first row is 1, a; expected the column names first, note, as in"),
        (b'"a\nb",c\n1,2\n', "1:1: the first row is a?b, c; expected the column names first, note, as"),
        (b"first|note\n1|a\n", "1:1: the first row is first|note; expected the column names first, note, as"),
        (b"First,FIRST,note\n1,2,a\n", "1:7: the column 'first' appears twice"),
        (b"first,note\n1,a\n2,caf\xe9\n", "3:6: not UTF-8: found the byte 0xe9; save the table as UTF-8 text"),
        (b'first,note\n1,"a\n', '2:3: the quotes of "a do not end with the cell; double quotes inside them'),
        (b'first,note\n1,"a"b\n', '2:3: the quotes of "a"b do not end with the cell'),
        (b"first,note\n1,a\0b\n", "2:3: 'a\\x00b' holds a control character; expected text"),
        (b"first,note\n1,a\n1,a\n", "3:1: this row appears twice; the first is at"),
        (b"first,note\nx,a\n", "2:1: parameter 'first' should be a valid number; found \"x\""),
        (b"first,note\n1,2\n", "2:3: parameter 'note' should be a valid string; found 2"),
        (b"first,nota\n1,a\n", "1:1: the first row is first, nota; expected the column names first, note, as in"),
        (b"first,note\n1e999,a\n", "2:1: first is inf, which is not a finite number"),
    ],
)
def test_one_problem(workspace: Workspace, content: bytes, problem: str) -> None:
    workspace.write(EACH)
    (workspace.folder / "rows.csv").write_bytes(content)
    found = [line.removeprefix(f"{workspace.folder}/rows.csv:") for line in workspace.problems()]
    assert [line[: len(problem)] for line in found] == [problem]


def test_all_problems_at_once(workspace: Workspace) -> None:
    workspace.write(EACH)
    (workspace.folder / "rows.csv").write_text('first,first\n1\n1,"a\n')
    found = [line.removeprefix(f"{workspace.folder}/rows.csv:").split(": ")[0] for line in workspace.problems()]
    assert found == ["1:7", "2:1", "3:3"]


@pytest.mark.parametrize(
    "text",
    [
        "First,NOTE\n7,x\n",
        " first , note \n7,x\n",
        '"First" ," Note "\n7,x\n',
        "\ufefffirst,note\n7,x\n",
        "first;note\n7;x\n",
        '\ufeff"First";"Note"\r\n7;x\r\n',
        "First\tNote\n7\tx\n",
        "\nfirst;note\n7;x\n",
        "First,note,first_of_all\n7,x,y\n",
    ],
)
def test_what_a_spreadsheet_makes_of_the_names(workspace: Workspace, text: str) -> None:
    """Capitals, blanks, a byte order mark, other separators: what is meant is clear."""
    (workspace.folder / "rows.csv").write_bytes(text.encode())
    (node,) = workspace.write(EACH).open().graph.nodes.values()
    assert (node.parameters["first"], node.parameters["note"]) == (7.0, "x")


def test_in_a_table_with_semicolons_a_cell_may_hold_commas(tmp_path: Path) -> None:
    rows, _ = read(tmp_path / "rows.csv", b'a;b;c\n1,5;"x;y";\n')
    assert rows == [{"a": "1,5", "b": "x;y", "c": None}]
    rows, _ = read(tmp_path / "rows.csv", b"a\tb\tc\n\t1;2 \tx,y\n")
    assert rows == [{"a": None, "b": "1;2", "c": "x,y"}]
    rows, _ = read(tmp_path / "rows.csv", b"a,b\n1;2,x\ty\n")
    assert rows == [{"a": "1;2", "b": "x\ty"}]


def test_capitals_that_the_workflow_tells_apart_stay(workspace: Workspace) -> None:
    workspace.write(EACH.replace("${item.note}", "${item.First}"))
    (workspace.folder / "rows.csv").write_text("First,first\na,1\n")
    (node,) = workspace.open().graph.nodes.values()
    assert (node.parameters["first"], node.parameters["note"]) == (1.0, "a")
    (workspace.folder / "rows.csv").write_text("FIRST,x\na,1\n")
    (problem,) = workspace.problems()
    assert "the first row is FIRST, x; expected the column names first, First, as in the workflow" in problem


def test_a_mistake_in_the_names_is_told_once(workspace: Workspace) -> None:
    """However many stages use them; a column whose use a setting replaces is not required."""
    workspace.write("""
        vars: {rows: rows.csv}
        stages:
          a: {uses: numbers, foreach: "${rows}", with: {first: "${item.first}"}}
          b: {uses: numbers, foreach: "${rows}", with: {note: "${item.note}"}}
          c: {uses: scale, foreach: "${rows}", in: {numbers: a}, with: {factor: "${item.factor}"}}
        """)
    (workspace.folder / "rows.csv").write_text("erste,notiz\n1,a\n")
    (problem,) = workspace.problems()
    assert problem.endswith(
        "rows.csv:1:1: the first row is erste, notiz; expected the column names first, note, factor, as in the workflow"
    )
    (workspace.folder / "rows.csv").write_text("first,Factor\n1,2\n")
    assert len(workspace.problems()) == 1
    assert workspace.problems("b.note=x") == []


def test_a_missing_table_is_told_where_it_is_named(workspace: Workspace) -> None:
    (problem,) = workspace.write(EACH).problems()
    assert problem.startswith("2:34: cannot read the table")
    assert "rows.csv': No such file or directory; expected a CSV file with a first row with" in problem


def test_a_table_of_set_is_relative_to_the_current_directory_and_its_paths_to_the_table(
    workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lists, here = tmp_path / "lists", tmp_path / "here"
    for folder in (lists, here):
        folder.mkdir()
    (lists / "data").mkdir()
    (lists / "data" / "numbers.txt").write_text("5\n")
    (lists / "rows.csv").write_text("file\nnumbers.txt\n")
    monkeypatch.chdir(here)
    workspace.write("""
        vars: {rows: null}
        stages:
          each: {uses: numbers, foreach: "${rows}", with: {file: "${item.file}"}}
        """)
    (problem,) = workspace.problems("rows=../lists/rows.csv")
    assert "rows.csv:2:1: parameter 'file': there is no file or folder" in problem
    workspace.file.write_text(workspace.file.read_text().replace("${item.file}", "${item.file}/numbers.txt"))
    (lists / "rows.csv").write_text("file\ndata\n")
    assert workspace.run("rows=../lists/rows.csv").values("each[data]").tolist() == [5.0]


@settings(deadline=None, max_examples=50)
@given(names=NAMES, data=st.data())
def test_what_the_csv_module_writes_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, names: list[str], data: st.DataObject
) -> None:
    """Quoted cells are read as they are, whatever is in them, and lines may end in either way."""
    rows = data.draw(st.lists(st.tuples(*(TEXT for _ in names)), min_size=1, max_size=4))
    text = io.StringIO(newline="")
    end = data.draw(st.sampled_from(["\n", "\r\n"]))
    csv.writer(text, lineterminator=end).writerow(names)
    csv.writer(text, quoting=csv.QUOTE_ALL, lineterminator=end).writerows(rows)
    path = tmp_path_factory.getbasetemp() / "hypothesis.csv"
    found, problems = read(path, text.getvalue().encode("utf-8-sig"))
    assert (found, len(problems)) == ([dict(zip(names, row, strict=True)) for row in rows], 0)


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        ("1", 1),
        ("-2.5e-3", -0.0025),
        ("true", True),
        ("null", None),
        ("", None),
        ('""', ""),
        ('"1"', "1"),
        ("007", "007"),
        ("1" * 5000, "1" * 5000),
        ("1_000", "1_000"),
        ("2020-01-01", "2020-01-01"),
        ("yes", "yes"),
        ("  a b ", "a b"),
        (' " a" ', " a"),
        ('5" disk', '5" disk'),
        ('"say ""a"", b"', 'say "a", b'),
    ],
)
def test_cells(tmp_path: Path, cell: str, value: object) -> None:
    rows, _ = read(tmp_path / "rows.csv", f"a,b\n{cell},x\n".encode())
    assert rows is not None
    assert (rows[0]["a"], type(rows[0]["a"])) == (value, type(value))


@pytest.mark.parametrize("cell", ["", "null", "2024"])
def test_a_cell_that_was_to_be_a_text_says_how_to_quote_it_there(workspace: Workspace, cell: str) -> None:
    workspace.write('stages:\n  each: {uses: say, foreach: rows.csv, with: {word: "${item.word}"}}')
    (workspace.folder / "rows.csv").write_text(f"word,other\n{cell},1\n")
    [told] = workspace.problems()
    [advised] = re.findall(r'(?:a YAML file, )("\w+")(?: in a CSV)', told)
    (workspace.folder / "rows.csv").write_text(f"word,other\n{advised},1\n")
    (node,) = workspace.open().graph.nodes.values()
    assert node.parameters["word"] == (cell or "null")


def test_lines_of_empty_cells_are_no_rows(tmp_path: Path) -> None:
    """Spreadsheets write them below a table; as rows, they would run a stage with its defaults."""
    rows, problems = read(tmp_path / "rows.csv", b"a,b\n1,x\n,\n , \n2,y\n,\n")
    assert (rows, len(problems)) == ([{"a": 1, "b": "x"}, {"a": 2, "b": "y"}], 0)


@pytest.mark.parametrize(
    "text", [b"a,b,\n1,x,\n2,y,\n", b"a,b,,\n1,x\n2,y,,", b"a;b;\n1;x;\n2;y; \n", b"a,b\n1,x,\n2,y\n"]
)
def test_last_columns_that_are_empty_in_every_row_are_none(tmp_path: Path, text: bytes) -> None:
    """Spreadsheets go on writing a column that was emptied."""
    rows, problems = read(tmp_path / "rows.csv", text)
    assert (rows, len(problems)) == ([{"a": 1, "b": "x"}, {"a": 2, "b": "y"}], 0)


def test_a_named_column_may_be_empty_and_an_unnamed_one_may_not(tmp_path: Path) -> None:
    rows, _ = read(tmp_path / "rows.csv", b"a,b\n1,\n2,\n")
    assert rows == [{"a": 1, "b": None}, {"a": 2, "b": None}]
    rows, problems = read(tmp_path / "rows.csv", b"a,b,\n1,x,\n2,y,z\n")
    assert rows is None
    assert len(problems) > 0


@settings(deadline=None, max_examples=50)
@given(st.binary(max_size=60))
def test_any_bytes_give_rows_or_a_reason(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    rows, problems = read(tmp_path_factory.getbasetemp() / "any.csv", content)
    assert (rows is None) == (len(problems) > 0)
