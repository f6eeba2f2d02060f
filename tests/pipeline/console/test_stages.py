"""`stages`: the list is read from the sources; of one stage everything that a workflow can give it is shown."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import BaseModel, Field
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.code.value_words import value_words
from pipeline.module_names import ModuleIn
from pipeline.stage import ExternalPath, Parameters
from tests.pipeline.helpers import TOYS


def call(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["stages", *arguments, "--stages", TOYS])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_the_list_names_every_stage_and_imports_none() -> None:
    for name in ("numbers", "scale"):
        sys.modules.pop(f"{TOYS}.{name}", None)
    lines = call().splitlines()
    assert [line.split()[0] for line in lines] == sorted(path.stem for path in toys())
    assert f"{TOYS}.numbers" not in sys.modules
    rows = [json.loads(line) for line in call("--json").splitlines()]
    assert {row["name"] for row in rows} == {path.stem for path in toys()}
    assert next(row["summary"] for row in rows if row["name"] == "scale") == "Multiplies numbers."


def toys() -> list[Path]:
    return list((Path(__file__).parents[1] / "toys").glob("[!_]*.py"))


def test_of_one_stage_all_is_shown_that_a_workflow_can_give_it() -> None:
    text = call("scale")
    assert text.startswith("scale: Multiplies numbers.\n")
    assert "\nin\n  numbers  numbers\n" in text
    assert "\nout\n  numbers  numbers, private if an input is\n" in text
    assert "\n  factor: number" in text
    fields = json.loads(call("scale", "--json"))
    assert fields["inputs"]["numbers"] == {"kind": "numbers", "many": False, "optional": False, "labelled": False}
    assert fields["parameters"]["factor"]["values"] == "number"


@pytest.mark.parametrize(("name", "package", "said"), [("scael", TOYS, "did you mean 'scale'"), ("x", "no.such", "no")])
def test_what_is_not_there_is_told(name: str, package: str, said: str) -> None:
    result = CliRunner().invoke(app, ["stages", name, "--stages", package])
    assert (result.exit_code, result.stdout) == (2, "")
    assert said in result.stderr


class Move(BaseModel):
    """One of two mappings."""

    edit: Literal["move"]
    by: float


class Turn(BaseModel):
    """The other."""

    edit: Literal["turn"]
    angle: float


class Everything(Parameters):
    """A parameter of each kind."""

    count: int = Field(1, ge=1, le=9)
    even: int = Field(2, multiple_of=2)
    share: float = Field(0.5, gt=0, lt=1)
    on: bool = True
    mode: Literal["auto", "given"] = "auto"
    size: Literal[1, 3] = 1
    perhaps: int | None = Field(None, ge=0)
    either: Literal["auto", "given"] | None = None
    folder: ExternalPath | None = None
    names: tuple[str, ...] = ()
    steps: tuple[Annotated[int, Field(ge=0)], ...] = ()
    pair: tuple[int, float] = (1, 1.0)
    toy: Annotated[str, ModuleIn(f"{TOYS}")] = "scale"
    edits: list[Annotated[Move | Turn, Field(discriminator="edit")]] = Field(default_factory=list)
    own: dict[str, Any] = Field(default_factory=dict)


WORDS: Mapping[str, str] = {
    "count": "integer ≥ 1 and ≤ 9",
    "even": "integer a multiple of 2",
    "share": "number > 0 and < 1",
    "on": "true | false",
    "mode": "auto | given",
    "size": "1 | 3",
    "perhaps": "integer ≥ 0 or null",
    "either": "auto | given, or null",
    "folder": "path or null",
    "names": "list of: text",
    "steps": "list of: integer ≥ 0",
    "pair": "[integer, number]",
    "toy": " | ".join(sorted(path.stem for path in toys())),
    "edits": "list of: {edit: move, by} or {edit: turn, angle}",
    "own": "mapping",
}


@pytest.mark.parametrize("name", WORDS)
def test_values_in_words(name: str) -> None:
    field = Everything.model_fields[name]
    assert value_words(field.annotation, field.metadata) == WORDS[name]
