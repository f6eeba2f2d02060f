"""All that is wrong with a workflow is said at once, with its place, what is allowed and the nearest name."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from pipeline.store.store import Store
from tests.pipeline.helpers import Workspace


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "a: {usess: numbers}",
            "2:7: unknown key 'usess' in stage 'a'; allowed: uses, in, with, foreach, matrix, private",
        ),
        ("a: {usess: numbers}", "2:3: stage 'a' has no 'uses'"),
        (
            "a: {uses: numbrs}",
            "2:13: no stage 'numbrs'; there are doubt, draw, environment, equipped, fail, flaky, gate, keep, mark",
        ),
        ("a: {uses: }", "2:3: stage 'a' has no 'uses'"),
        ("a: {uses: ~}\n  b: {uses: total, in: {numbers: [a]}}", "2:3: stage 'a' has no 'uses'"),
        (
            "a: {foreach: {kind: [numbers, null]}, uses: '${item.kind}'}",
            "2:47: uses is nothing; expected the name of a stage",
        ),
        ("a: {uses: 3}", "2:13: uses is the number 3; expected the name of a stage"),
        (
            "a: {uses: numbers, with: {cuont: 3}}",
            "2:29: unknown parameter 'cuont'; allowed: count, first, note, file; did you mean 'count'?",
        ),
        (
            "a: {uses: numbers, with: {count: three}}",
            """2:36: parameter 'count' should be a valid integer; found "three\"""",
        ),
        ("a: {uses: numbers, with: {count: 1.5}}", "2:36: parameter 'count' should be a valid integer"),
        ("a: {uses: numbers, with: {first: .nan}}", "2:36: parameter 'first' should be a finite number; found NaN"),
        ("a: {uses: numbers, with: {count: true}}", "2:36: parameter 'count' should be a valid integer; found true"),
        ("a: {uses: numbers, with: {count: -1}}", "2:36: parameter 'count' should be greater than or equal to 0"),
        ("a: {uses: numbers, with: {file: no.txt}}", "2:35: parameter 'file': there is no file or folder"),
        ("a: {uses: numbers, with: [count]}", "2:28: 'with' of stage 'a' is a list; expected a mapping"),
        ("a: {uses: numbers, private: yes}", "2:31: private is the text 'yes'; expected true or false"),
        ("a: {uses: scale}", "2:3: input 'numbers' of 'a' (kind numbers) is missing"),
        (
            "a: {uses: scale, in: {number: b}}",
            "2:25: scale has no input 'number'; it has numbers; did you mean 'numbers'?",
        ),
        ("a: {uses: scale, in: {numbers: b}}", "2:34: no stage 'b'; there are a"),
        ("a: {uses: scale, in: {numbers: 3}}", "2:34: input 'numbers' is the number 3; expected STAGE or STAGE.OUTPUT"),
        ("a: {uses: scale, in: {numbers: a}}", "2:34: stages depend on each other in a circle: a → a"),
        (
            "a: {uses: numbers}\n  b: {uses: scale, in: {numbers: a.number}}",
            "3:34: 'a' has no output 'number'; there are a.numbers; did you mean 'numbers'?",
        ),
        (
            "a: {uses: numbers}\n  b: {uses: scale, in: {numbers: [a, a]}}",
            "3:25: input 'numbers' takes one artifact; found a list",
        ),
        (
            "a: {uses: total, in: {numbers: []}}\n  b: {uses: scale, in: {numbers: a}}",
            "3:34: 'a' has several outputs; choose one of a.total, a.page, a.key",
        ),
        (
            "a: {uses: total, in: {numbers: []}}\n  b: {uses: scale, in: {numbers: a.page}}",
            "3:34: a.page is of kind report; this input takes kind numbers",
        ),
        ("a: {uses: numbers}\n  a: {uses: scale}", "3:3: 'a' appears twice"),
        ("a b: {uses: numbers}", "2:3: 'a b' cannot name a stage"),
        ("a: {uses: numbers, foreach: {x: []}}", "2:35: foreach.x is a list; expected a list with at least one item"),
        (
            "a: {uses: numbers, foreach: {x: [1], y: [1, 2]}}",
            "2:31: the lists of a foreach must have the same length; found x: 1, y: 2",
        ),
        (
            "a: {uses: numbers, foreach: {x: [1, 2]}, with: {count: '${item.y}'}}",
            "2:58: ${item.y} is not known; known: ${item.x}",
        ),
        (
            "a: {uses: numbers, foreach: {x: [1, 2]}}\n  b: {uses: scale, in: {numbers: a}}",
            "3:34: input 'numbers' takes one artifact; found all 2 items of a foreach",
        ),
        (
            "a: {uses: numbers, with: {count: 2020-01-01}}",
            "2:36: parameter 'count' should be a valid integer",
        ),
        ("a: {uses: numbers, with: {count: '${count}'}}", "2:36: ${count} is not known; known: none"),
        ("a: [1,", "3:1: not YAML"),
        ("a: " + "[" * 500 + "]" * 500, " not YAML 1.2, or nested more than 50 levels deep"),
        ("a: {uses: numbers, private: !!bool maybe}", "2:31: 'maybe' is neither text, a number, true, false nor null"),
        ("a: {uses: numbers, with: {count: !!int ''}}", "2:36: '' is neither text, a number, true, false nor null"),
        (
            f"a: {{uses: numbers, with: {{count: 0x{'f' * 4000}}}}}",
            "2:36: a number of more than 1024 bits",
        ),
        ('a: {uses: numbers, with: {file: "a\\0b"}}', "2:35: parameter 'file': there is no file or folder"),
        (f"a: {{uses: numbers, with: {{file: {'x' * 5000}}}}}", "2:35: parameter 'file': there is no file or folder"),
    ],
)
def test_one_problem(workspace: Workspace, text: str, problem: str) -> None:
    found = workspace.write(f"stages:\n  {text}\n").problems()
    assert any(line.startswith(problem) for line in found), found


def test_all_problems_at_once(workspace: Workspace) -> None:
    workspace.write("""\
        name: many
        vars: {cover: null}
        stags: {}
        stages:
          base: {usess: numbers, uses: numbers, with: {count: "3", file: nowhere.txt}}
          left: {uses: scale, in: {numbers: right}}
          right: {uses: scale, in: {numbers: left}}
          page: {uses: total, in: {numbers: base}}
          mixed: {uses: scale, in: {numbers: page.page}}
          lone: {uses: scale}
          given: {uses: numbers, with: {file: "${cover}"}}
        """)
    found = workspace.problems("nothing=1")
    places = [line.split(": ")[0] for line in found]
    assert places == ["--set nothing", "2:15", "3:1", "5:10", "5:55", "5:66", "7:38", "9:38", "10:3"]
    assert found[1] == "2:15: the var 'cover' has no value; give it with --set cover=VALUE"


def test_a_circle_is_reported_once(workspace: Workspace) -> None:
    workspace.write("""\
        stages:
          a: {uses: scale, in: {numbers: b}}
          b: {uses: scale, in: {numbers: c}}
          c: {uses: scale, in: {numbers: a}}
        """)
    assert workspace.problems() == ["4:34: stages depend on each other in a circle: a → b → c → a"]


@pytest.mark.parametrize(
    ("setting", "problem"),
    [
        ("widht=3", "--set widht: no such var or stage; known: width, base.PARAMETER; did you mean 'width'?"),
        ("bas.count=3", "--set bas.count: no such var or stage"),
        ("base=3", "--set base: no such var or stage; known: width, base.PARAMETER; 'base' is a stage: set one of"),
        ("base.cuont=3", "--set base.cuont: unknown parameter 'cuont'"),
        ("base.count=three", "--set base.count: parameter 'count' should be a valid integer"),
        ("width=three", "--set width: parameter 'count' should be a valid integer"),
        ("width", "--set width: expected NAME=VALUE or STAGE.PARAMETER=VALUE"),
        ("width=[", "--set width: not YAML"),
        (
            "base.note=holiday #2",
            """--set base.note: '#2' would be read as a comment; quote the value: --set 'base""",
        ),
        ("base.note=#ffffff", "--set base.note: '#ffffff' would be read as a comment"),
        (
            "base.note=2024",
            "--set base.note: parameter 'note' should be a valid string; found 2024; to give this as a text, "
            """quote it: '2024' in a YAML file, "2024" in a CSV, "'2024'" after --set NAME=""",
        ),
        ("base.note=0123", """--set base.note: parameter 'note' should be a valid string; found 123; to give this"""),
        ("base.file=2024", "--set base.file: parameter 'file': there is no file or folder"),
        ("base.note=true", """--set base.note: parameter 'note' should be a valid string; found true; to give this"""),
        ("base.file='2024'", "--set base.file: parameter 'file': there is no file or folder"),
        ("base.file=nowhere.txt", "--set base.file: parameter 'file': there is no file or folder"),
    ],
)
def test_settings_are_checked_and_blamed(workspace: Workspace, setting: str, problem: str) -> None:
    workspace.write("vars: {width: 3}\nstages:\n  base: {uses: numbers, with: {count: '${width}'}}\n")
    found = workspace.problems(setting)
    assert any(line.startswith(problem) for line in found), found


def test_a_path_made_of_what_was_set_says_by_what(workspace: Workspace) -> None:
    workspace.write("vars: {folder: null}\nstages:\n  a: {uses: numbers, with: {file: '${folder}/five.txt'}}\n")
    [problem] = workspace.problems("folder=nowhere")
    assert "there is no file or folder" in problem
    assert "/nowhere/five.txt' (from --set folder)" in problem


def test_rows_that_are_set_may_refer_to_vars_as_those_in_the_workflow_do(workspace: Workspace) -> None:
    workspace.write(
        """
        vars: {count: 7, note: x, rows: [{count: "${count}", note: a}]}
        stages:
          a: {uses: numbers, foreach: "${rows}", with: {count: "${item.count}", note: "${item.note}"}}
          b: {uses: numbers, with: {note: "${note}"}}
        """
    )
    graph = workspace.open("count=5", "rows=[{count: '${count}', note: 'no ${count}'}]", "note=a ${count} $$ b").graph
    assert [node.parameters["note"] for node in graph.nodes.values()] == ["no 5", "a ${count} $$ b"]
    assert next(iter(graph.nodes.values())).parameters["count"] == 5
    [problem] = workspace.problems("rows=[{count: '${cuont}', note: a}]")
    assert problem.startswith("--set rows: ${cuont} is not known; known: ${count}, ${note}; did you mean")


@pytest.mark.parametrize(
    ("setting", "note"), [("'holiday #2'", "holiday #2"), ('"#fff"', "#fff"), ("a#b", "a#b"), ("it's", "it's")]
)
def test_what_is_no_comment_in_a_setting_is_kept(workspace: Workspace, setting: str, note: str) -> None:
    workspace.write("stages:\n  a: {uses: numbers}\n")
    assert workspace.open(f"a.note={setting}").graph.nodes["a"].parameters["note"] == note


def test_a_long_chain_may_stand_in_the_file_the_wrong_way_round(workspace: Workspace) -> None:
    chain = [f"  s{number}: {{uses: scale, in: {{numbers: s{number + 1}}}}}" for number in range(1500)]
    workspace.write("\n".join(["stages:", *chain, "  s1500: {uses: numbers}"]))
    steps = workspace.plan()
    assert list(steps) == [f"s{number}" for number in reversed(range(1501))]


def test_an_empty_path_is_not_the_folder_of_the_workflow(workspace: Workspace) -> None:
    message = "parameter 'file': an empty path; expected the path of a file or folder"
    workspace.write("stages:\n  a: {uses: numbers, with: {file: ''}}\n")
    assert workspace.problems() == [f"2:35: {message}"]
    workspace.write("stages:\n  a: {uses: numbers}\n")
    assert workspace.problems("a.file=''") == [f"--set a.file: {message}"]
    (workspace.folder / "rows.csv").write_text('file\n""\n')
    workspace.write("stages:\n  a: {uses: numbers, foreach: rows.csv, with: {file: '${item.file}'}}\n")
    assert [problem.partition("rows.csv:")[2] for problem in workspace.problems()] == [f"2:1: {message}"]


def test_a_path_that_is_a_link_to_itself_is_told(workspace: Workspace) -> None:
    (workspace.folder / "loop").symlink_to("loop")
    workspace.write("stages:\n  a: {uses: numbers, with: {file: loop}}\n")
    assert workspace.problems()[0].startswith("2:35: parameter 'file': there is no file or folder")


def test_substitution_keeps_types(workspace: Workspace) -> None:
    workspace.write("""
        vars: {count: 7, name: x, both: "${name}-${count}"}
        stages:
          a: {uses: numbers, with: {count: "${count}", note: "${both} $${name} costs 3$", first: 1e-4}}
        """)
    assert workspace.open().graph.nodes["a"].parameters == {
        "count": 7,
        "first": 1e-4,
        "note": "x-7 ${name} costs 3$",
    }


def test_a_wrong_var_is_blamed_where_it_stands(workspace: Workspace) -> None:
    workspace.write("vars: {count: x}\nstages:\n  a: {uses: numbers, with: {count: '${count}'}}\n")
    assert workspace.problems() == ["1:15: parameter 'count' should be a valid integer; found \"x\""]


@pytest.mark.parametrize(
    "text", ["", "3", "[]", "null", "stages: 3", "stages:", "name: x", "stages: {a: 3}", "? [a]\n: b"]
)
def test_any_shape_gives_a_message(workspace: Workspace, text: str) -> None:
    assert workspace.write(text).problems()


def test_an_alias_of_itself_ends(workspace: Workspace) -> None:
    assert workspace.write("stages: &a\n  x: *a\n").problems()


def test_a_tilde_is_the_home_folder(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(workspace.folder / "home"))
    (workspace.folder / "home").mkdir()
    (workspace.folder / "home" / "given.txt").write_text("1")
    (workspace.folder / "home" / "rows.csv").write_text("first\n1\n2\n")
    workspace.write("""
        stages:
          base: {uses: numbers, with: {file: ~/given.txt}}
          each: {foreach: ~/rows.csv, uses: numbers, with: {first: "${item.first}"}}
        """)
    assert workspace.problems() == []
    assert Store(Path("~/results")).root == workspace.folder / "home" / "results"
    assert "there is no file" in workspace.problems("base.file=~nobody-of-this-name/given.txt")[0]


def bomb(line: str, levels: int = 10) -> str:
    """A vars section in which each line contains the one before ten times."""
    names = "abcdefghijklmnop"[:levels]
    grown = [f"  {name}: {line.format(before)}" for before, name in pairwise(names)]
    return "\n".join(["vars:", "  a: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]" if "[" in line else "  a: abcdefghij", *grown])


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        (
            "[" + ", ".join(['"${{{0}}}"'] * 10) + "]",
            "values once every ${…} is replaced; at most 1,000,000 are allowed",
        ),
        ("${{{0}}}" * 10, "characters once every ${…} is replaced; at most 1,048,576 are allowed"),
    ],
)
def test_what_grows_tenfold_a_line_is_refused(workspace: Workspace, line: str, problem: str) -> None:
    workspace.write(f"{bomb(line)}\nstages:\n  base: {{uses: numbers}}")
    assert any(problem in each for each in workspace.problems())


def test_aliases_count_each_time(workspace: Workspace) -> None:
    lines = [f"  {name}: &{name} [{', '.join([f'*{before}'] * 10)}]" for before, name in pairwise("abcdefgh")]
    text = ["vars:", "  a: &a [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]", *lines, "stages:", "  base: {uses: numbers}"]
    workspace.write("\n".join(text))
    assert any("more than the 1,000,000 values" in each for each in workspace.problems())
