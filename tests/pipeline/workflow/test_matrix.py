"""Rows of `foreach` and `matrix`: which there are, their order, their names, and which belong together."""

from __future__ import annotations

import itertools
import json
import os
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pipeline.workflow.located import Problems, read_yaml
from pipeline.workflow.matrix import Rows, expand
from tests.pipeline.helpers import Workspace

SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**6), 10**6),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs", "Zl", "Zp"]), max_size=60),
)
VALUES = st.one_of(
    SCALARS,
    st.lists(SCALARS, max_size=3),
    st.dictionaries(st.from_regex(r"[a-z]{1,4}", fullmatch=True), SCALARS, max_size=3),
)
NAMES = st.lists(st.from_regex(r"[a-z]{1,4}", fullmatch=True), min_size=1, max_size=3, unique=True)


def spelled(value: object) -> str:
    return json.dumps(value, sort_keys=True, ensure_ascii=False)


def rows_of(key: str, value: object) -> tuple[Rows | None, list[str]]:
    problems = Problems()
    located = read_yaml(spelled(value), "w.yaml", Path("/nowhere"), problems)
    assert located is not None
    rows = expand(key, located, problems)
    return rows, [str(problem) for problem in problems]


@st.composite
def tables(draw: st.DrawFn, values: st.SearchStrategy[object] = VALUES) -> tuple[list[str], list[tuple[object, ...]]]:
    names = draw(NAMES)
    rows = draw(st.lists(st.tuples(*(values for _ in names)), min_size=1, max_size=6, unique_by=spelled))
    return names, rows


def test_rows_are_named_after_what_is_in_lists_and_mappings() -> None:
    """Such as settings of a method of one's own, which rows of other methods do not have."""
    own = [{}, {"levels": 2}, {"levels": [2]}, ["reef", "fox"]]
    rows, _ = rows_of("foreach", [{"cover": "fox", "own": value} for value in own])
    assert rows is not None
    assert rows.labels(["cover", "own"]) == ["fox", "fox,levels-2", "#3", "fox,reef-fox"]
    assert rows.labels(["own"])[:2] == ["#1", "levels-2"]


@settings(deadline=None, max_examples=50)
@given(tables())
def test_rows_and_columns_are_the_same_in_order(table: tuple[list[str], list[tuple[object, ...]]]) -> None:
    names, values = table
    by_row, problems = rows_of("foreach", [dict(zip(names, row, strict=True)) for row in values])
    by_column, _ = rows_of("foreach", {name: [row[index] for row in values] for index, name in enumerate(names)})
    assert problems == []
    assert by_row is not None
    assert by_column is not None
    assert [spelled([row[name] for name in names]) for row in by_row.plain] == [spelled(row) for row in values]
    assert by_row.identity == by_column.identity


@settings(deadline=None, max_examples=50)
@given(tables())
def test_labels_are_unique_and_can_name_files(table: tuple[list[str], list[tuple[object, ...]]]) -> None:
    names, values = table
    rows, _ = rows_of("foreach", [dict(zip(names, row, strict=True)) for row in values])
    assert rows is not None
    for columns in (names, names[:1]):
        labels = rows.labels(columns)
        kinds = [spelled([row[names.index(name)] for name in columns]) for row in values]
        assert len(set(zip(kinds, labels, strict=True))) == len(set(kinds)) == len(set(labels))
        for label in labels:
            assert 0 < len(label.encode()) <= 200
            assert "/" not in label
            assert label.isprintable()


@settings(deadline=None, max_examples=50)
@given(st.lists(st.from_regex(r"[a-z/. ]{1,50}", fullmatch=True), min_size=1, max_size=6, unique=True), st.data())
def test_a_label_stays_when_other_rows_come_or_go(texts: list[str], data: st.DataObject) -> None:
    kept = data.draw(st.lists(st.sampled_from(texts), min_size=1, unique=True))
    every, _ = rows_of("foreach", {"text": texts})
    some, _ = rows_of("foreach", {"text": kept})
    assert every is not None
    assert some is not None
    label = dict(zip(texts, every.labels(["text"]), strict=True))
    assert some.labels(["text"]) == [label[text] for text in kept]


@settings(deadline=None, max_examples=50)
@given(
    st.dictionaries(
        st.from_regex(r"[a-d]", fullmatch=True),
        st.lists(st.integers(0, 9), min_size=1, max_size=3, unique=True),
        min_size=1,
    )
)
def test_a_matrix_is_every_combination_the_first_list_slowest(lists: dict[str, list[int]]) -> None:
    rows, problems = rows_of("matrix", lists)
    assert problems == []
    assert rows is not None
    names = sorted(lists)
    assert [tuple(row[name] for name in names) for row in rows.plain] == list(
        itertools.product(*(lists[name] for name in names))
    )


def test_exclude_and_include() -> None:
    rows, _ = rows_of(
        "matrix", {"a": [1, 2], "b": [3, 4], "exclude": [{"a": 1, "b": 4}], "include": [{"a": 9, "b": 9}]}
    )
    assert rows is not None
    assert rows.labels(rows.columns) == ["1,3", "2,3", "2,4", "9,9"]
    rows, _ = rows_of("matrix", {"a": [1, 2], "b": [3, 4], "exclude": [{"a": 1}]})
    assert rows is not None
    assert rows.labels(rows.columns) == ["2,3", "2,4"]


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        ("foreach", "3", "foreach is the number 3; expected lists such as {cover: [a, b], message: [c, d]}, a list of"),
        ("foreach", "[]", "foreach is a list; expected lists such as"),
        ("foreach", "{}", "foreach is a mapping; expected lists such as"),
        (
            "foreach",
            "[a]",
            "a row of foreach is the text 'a'; expected names, each with a value: {cover: a, message: b}",
        ),
        ("foreach", "[{a: 1}, {b: 2}]", "this row has 'b', which the first row lacks; it has a"),
        ("foreach", "[{a: 1, b: 2}, {a: 2}]", "this row has no b; expected all of a, b"),
        ("foreach", "[{a: 1}, {a: 1}]", "this row appears twice; the first is at w.yaml:1:6"),
        ("foreach", "{a: [1, 2, 1]}", "this row appears twice; the first is at w.yaml:1:6"),
        ("foreach", "[{a b: 1}]", "'a b' cannot name a column; expected letters, digits, '_' and '-'"),
        ("foreach", "{a: [.inf]}", "a is inf, which is not a finite number"),
        (
            "foreach",
            "nowhere.csv",
            "cannot read the table '/nowhere/nowhere.csv': No such file or directory; expected a",
        ),
        ("matrix", "[1]", "matrix is a list; expected names, each with a list: {rate: [0.1, 0.2], size: [8, 16]}"),
        ("matrix", "{exclude: []}", "matrix is a mapping; expected names, each with a list"),
        ("matrix", "{a: 1}", "matrix.a is the number 1; expected a list with at least one item"),
        ("matrix", "{a: [1, 1]}", "this row appears twice"),
        ("matrix", "{a: [1], exclude: [{a: 2}]}", "this excludes no row of the matrix"),
        ("matrix", "{a: [1], exclude: [{a: 1}]}", "this matrix has no rows: all are excluded"),
        (
            "matrix",
            "{width: [1], exclude: [{widht: 1}]}",
            "the matrix has no 'widht'; it has width; did you mean 'width'?",
        ),
        ("matrix", "{a: [1], exclude: 3}", "matrix.exclude is the number 3; expected a list of rows: [{a: …}]"),
        ("matrix", "{a: [1], b: [1], include: [{a: 1}]}", "this row has no b; expected all of a, b"),
    ],
)
def test_what_is_wrong_with_rows(key: str, value: str, problem: str) -> None:
    problems = Problems()
    located = read_yaml(value, "w.yaml", Path("/nowhere"), problems)
    assert located is not None
    assert expand(key, located, problems) is None
    assert any(str(found).partition(": ")[2].startswith(problem) for found in problems), list(map(str, problems))


def test_of_many_equal_rows_some_are_told(workspace: Workspace) -> None:
    _, problems = rows_of("foreach", {"a": [1] * 1000})
    assert len(problems) == 4
    assert problems[-1].endswith("the first is at w.yaml:1:8 (and 995 more such rows)")


def test_rows_that_share_a_value_are_told_apart_in_time_that_grows_with_their_number() -> None:
    """Comparing each of forty thousand with all before it would take minutes."""
    rows, problems = rows_of("matrix", {"cover": ["fox"], "tens": list(range(200)), "ones": list(range(200))})
    assert not problems
    assert rows is not None
    assert rows.labels(["cover"]) == ["fox"] * 40_000
    assert len(set(rows.labels(["tens", "ones"]))) == 40_000


def test_a_value_of_a_million_letters_names_a_row_by_the_first() -> None:
    rows, _ = rows_of("foreach", {"cover": ["a" * 10**6]})
    assert rows is not None
    [label] = rows.labels(["cover"])
    assert label.startswith("aaa")
    assert len(label) == 40


def test_paths_that_are_spelt_alike_and_lead_elsewhere_are_two(workspace: Workspace, tmp_path: Path) -> None:
    """Paths in `--set` are relative to the current directory, those in a workflow to its file."""
    (workspace.folder / "n.txt").write_text("1")
    here = Path.cwd()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "n.txt").write_text("2")
    os.chdir(tmp_path / "other")
    try:
        ran = workspace.write("""
            vars: {mine: null}
            stages:
              a: {foreach: [{file: "${mine}", n: 1}, {file: n.txt, n: 2}], uses: numbers, with: {file: "${item.file}"}}
            """).run("mine=n.txt")
    finally:
        os.chdir(here)
    assert sorted(float(ran.values(name)[0]) for name in ran.ended) == [1, 2]


def test_a_matrix_has_its_bounds() -> None:
    _, problems = rows_of("matrix", {name: list(range(100)) for name in "abc"})
    assert problems == ["w.yaml:1:1: this matrix has 1,000,000 rows; at most 100,000 are allowed"]


@pytest.mark.parametrize(
    ("stages", "problem"),
    [
        ("a: {uses: numbers, foreach: {x: [1]}, matrix: {x: [1]}}", "2:49: stage 'a' has both 'foreach' and 'matrix'"),
        (
            "a: {uses: numbers}\n  b: {uses: scale, in: {numbers: {all: a, without_failed: true}}}",
            "3:25: input 'numbers' takes one artifact; 'without_failed' is only for lists",
        ),
        ("a: {uses: table, in: {numbers: {al: a}}}", "2:35: unknown key 'al' in input 'numbers'; allowed: all,"),
        ("a: {uses: table, in: {numbers: {without_failed: true}}}", "2:34: input 'numbers' has no 'all'; expected"),
        (
            "a: {uses: table, in: {numbers: {all: [], without_failed: 3}}}",
            "2:60: without_failed is the number 3; expected",
        ),
    ],
)
def test_what_is_wrong_in_a_workflow(workspace: Workspace, stages: str, problem: str) -> None:
    found = workspace.write(f"stages:\n  {stages}\n").problems()
    assert any(line.startswith(problem) for line in found), found


@settings(deadline=None, max_examples=50)
@given(tables(SCALARS), st.data())
def test_stages_of_the_same_rows_go_row_by_row(
    tmp_path_factory: pytest.TempPathFactory, table: tuple[list[str], list[tuple[object, ...]]], data: st.DataObject
) -> None:
    """Given as rows or as columns: each stage takes from its own row, and one without rows takes from all."""
    names, values = table
    used = data.draw(st.sampled_from(names))
    rows = [dict(zip(names, row, strict=True)) for row in values]
    assume(all(row[used] is not None for row in rows))
    columns = {name: [row[name] for row in rows] for name in names}
    content = {
        "stages": {
            "first": {"uses": "table", "foreach": rows, "in": {"numbers": []}, "private": False},
            "base": {"uses": "numbers", "foreach": rows, "with": {"note": f"n${{item.{used}}}"}},
            "next": {"uses": "scale", "foreach": columns, "in": {"numbers": "base"}},
            "all": {"uses": "table", "in": {"numbers": "next"}},
        }
    }
    workspace = Workspace(tmp_path_factory.getbasetemp())
    workspace.file.write_text(spelled(content))
    nodes = workspace.open().graph.nodes
    kinds = list(dict.fromkeys(spelled(row[used]) for row in rows))
    bases = [node for name, node in nodes.items() if name.startswith("base[")]
    assert len(bases) == len(kinds)
    nexts = [node for name, node in nodes.items() if name.startswith("next[")]
    assert [node.upstream for node in nexts] == [(node.name,) for node in bases]
    taken = [nodes[nodes[source.node].upstream[0]].parameters["note"] for source in nodes["all"].sources["numbers"]]
    texts = [str(row[used]).lower() if isinstance(row[used], bool) else str(row[used]) for row in rows]
    assert taken == [f"n{text}" for text in texts]
    assert [dict(label.values) for label in nodes["all"].labels["numbers"]] == rows


def test_columns_that_rows_of_a_setting_lack_are_told_once(workspace: Workspace) -> None:
    """And not once for every place that uses one."""
    workspace.write("""
        vars:
          rows:
            - {first: 1, count: 2, factor: 3}
        stages:
          base:  {foreach: "${rows}", uses: numbers, with: {first: "${item.first}", count: "${item.count}"}}
          twice: {foreach: "${rows}", uses: scale, in: {numbers: base}, with: {factor: "${item.factor}"}}
        """)
    assert workspace.problems() == []
    assert workspace.problems("rows=[{first: 1}]") == [
        "--set rows: this row has no count, factor; expected all of first, count, factor"
    ]
    assert workspace.problems("rows=[{First: 1, Count: 2, Factor: 3}]") == [
        "--set rows: this row has no first, count, factor; expected all of first, count, factor"
    ]
