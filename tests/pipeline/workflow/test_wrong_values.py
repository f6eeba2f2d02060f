"""A mistake that reaches many stages is one message, which names them and says what was probably meant."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from tests.pipeline.helpers import Workspace

STAGE = '''
"""A stage."""
from typing import Annotated
from pydantic import Field
from pipeline.module_names import ModuleIn
from pipeline.stage import Context, Output, Parameters, stage

class GivenParameters(Parameters):
    method: Annotated[str, ModuleIn("of_methods.methods")] = Field("plain", description="Which method.")

@stage(inputs={{}}, outputs={{"made": Output("text")}}, version=1)
def {name}(context: Context, parameters: GivenParameters) -> None:
    context.output("made").write_file("text", parameters.method)
'''
HIDES = """
    vars: {way: null}
    stages:
      hide:   {uses: hide, with: {method: "${way}"}}
      scores: {uses: score, with: {method: "${way}"}}
      path:   {uses: score, foreach: {method: ["${way}", fancy]}, with: {method: "${item.method}"}}
    """


@pytest.fixture
def methods(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> Iterator[Workspace]:
    """Stages that take a method; each method is a file of its own."""
    package = workspace.folder / "of_methods"
    (package / "methods").mkdir(parents=True)
    for name in ("plain", "fancy", "sh", "__init__"):
        (package / "methods" / f"{name}.py").touch()
    for name in ("hide", "score"):
        (package / f"{name}.py").write_text(STAGE.format(name=name))
    (package / "__init__.py").touch()
    monkeypatch.syspath_prepend(workspace.folder)
    workspace.package = package.name
    yield workspace
    for name in [name for name in sys.modules if name.partition(".")[0] == package.name]:
        del sys.modules[name]


def test_a_mistyped_method_is_one_message(methods: Workspace) -> None:
    assert methods.write(HIDES).problems("way=fency") == [
        "--set way: parameter 'method' of hide, scores and path should be 'fancy', 'plain' or 'sh'; found \"fency\"; "
        "did you mean 'fancy'?"
    ]
    assert methods.problems("way=3") == [
        "--set way: parameter 'method' of hide, scores and path should be a valid string; found 3; to give this "
        """as a text, quote it: '3' in a YAML file, "3" in a CSV, "'3'" after --set NAME="""
    ]
    assert methods.problems("way=sh") == []


def test_of_one_stage_it_needs_no_name(methods: Workspace) -> None:
    (problem,) = methods.write(HIDES).problems("way=fancy", "scores.method=x.y")
    assert problem == "--set scores.method: parameter 'method' should be 'fancy', 'plain' or 'sh'; found \"x.y\""
    (problem,) = methods.problems("way=fancy", "hide.method=plane")
    assert problem.endswith("should be 'fancy', 'plain' or 'sh'; found \"plane\"; did you mean 'plain'?")


def test_one_more_file_is_one_more_choice(methods: Workspace) -> None:
    assert methods.write(HIDES).problems("way=mine") != []
    (methods.folder / "of_methods/methods/mine.py").touch()
    assert methods.problems("way=mine") == []


def test_each_place_is_told_that_is_to_be_mended(methods: Workspace) -> None:
    methods.write(HIDES.replace('"${way}"', "fency"))
    places = [problem.split(": ")[0] for problem in methods.problems("way=plain")]
    assert places == ["4:39", "5:40", "6:44"]


def test_each_reason_is_told(workspace: Workspace) -> None:
    workspace.write("""
        vars: {many: 1}
        stages:
          a: {uses: numbers, with: {count: "${many}"}}
          b: {uses: numbers, with: {count: "${many}", first: "${many}"}}
        """)
    assert workspace.problems("many=x") == [
        "--set many: parameter 'count' of a and b should be a valid integer; found \"x\"",
        "--set many: parameter 'first' should be a valid number; found \"x\"",
    ]


@pytest.mark.parametrize("value", ["", " "])
def test_an_empty_value_is_not_taken_for_the_default(workspace: Workspace, value: str) -> None:
    """As with an empty shell variable: `--set count=$COUNT` would otherwise withdraw what the workflow states."""
    stated = "stages:\n  one: {uses: numbers, with: {count: 7}}"
    [told] = workspace.write(stated).problems(f"one.count={value}")
    assert told.startswith("--set one.count: no value was given; null withdraws what the workflow states")
    assert workspace.problems("one.count=null") == []


@pytest.mark.parametrize("value", ["null", "~"])
def test_a_value_that_is_none_is_told_so(workspace: Workspace, value: str) -> None:
    said = """
    vars: {word: none}
    stages:
      one: {uses: say, with: {word: "${word}"}}
      two: {uses: say, with: {word: "${word}"}}
    """
    assert workspace.write(said).problems(f"word={value}") == [
        "--set word: parameter 'word' of one and two: no value was given; expected a text. To give the text null, "
        """quote it: 'null' in a YAML file, "null" in a CSV, "'null'" after --set NAME="""
    ]
