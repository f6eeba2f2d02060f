"""Declaring stages, and running one without the engine."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from pydantic import Field, ValidationError

from pipeline.artifact import Artifact, create, load
from pipeline.errors import Interrupted
from pipeline.stage import Context, Input, Output, Parameters, Services, stage
from tests.running import run_stage


class ScaleParameters(Parameters):
    factor: float = Field(2.0, description="What the numbers are multiplied by.")
    steps: int = Field(1, description="How often.")
    mode: Literal["add", "multiply"] = Field("multiply", description="How.")


@stage(
    inputs={"numbers": Input("numbers"), "others": Input("numbers", many=True, optional=True)},
    outputs={"scaled": Output("numbers"), "public": Output("numbers", "public"), "key": Output("numbers", "private")},
    version=1,
)
def scale(context: Context, parameters: ScaleParameters) -> None:
    values = context.input("numbers").read("values") * parameters.factor
    context.record(count=len(context.input_many("others")))
    for name in ("scaled", "public", "key"):
        context.output(name).write("values", values)


def numbers(directory: Path, *, private: bool = False) -> Artifact:
    with create(directory, "numbers", private) as writer:
        writer.write("values", np.arange(3.0))
    return load(directory)


def test_run_stage(tmp_path: Path) -> None:
    outputs = run_stage(scale, ScaleParameters(factor=3), {"numbers": numbers(tmp_path / "in")}, tmp_path / "out")
    np.testing.assert_array_equal(outputs["scaled"].read("values"), [0.0, 3.0, 6.0])
    assert outputs["scaled"].path == tmp_path / "out" / "scaled"


@pytest.mark.parametrize("private", [False, True])
def test_privacy_of_outputs(tmp_path: Path, private: bool) -> None:
    given = {"numbers": numbers(tmp_path / "in", private=private)}
    outputs = run_stage(scale, ScaleParameters(), given, tmp_path / "out")
    assert {name: output.private for name, output in outputs.items()} == {
        "scaled": private,
        "public": False,
        "key": True,
    }


def test_where_the_workflow_says_private_nothing_is_public(tmp_path: Path) -> None:
    given = {"numbers": numbers(tmp_path / "in")}
    outputs = run_stage(scale, ScaleParameters(), given, tmp_path / "out", private=True)
    assert all(output.private for output in outputs.values())


def test_inputs_are_checked(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="'numbers' is missing"):
        run_stage(scale, ScaleParameters(), {}, tmp_path / "out")
    with pytest.raises(TypeError, match="no input 'number'"):
        run_stage(scale, ScaleParameters(), {"number": numbers(tmp_path / "a")}, tmp_path / "out")
    with create(tmp_path / "scene", "scene"):
        pass
    with pytest.raises(TypeError, match="takes a numbers, not a scene"):
        run_stage(scale, ScaleParameters(), {"numbers": load(tmp_path / "scene")}, tmp_path / "out")


@pytest.mark.parametrize(
    "values",
    [{"factr": 1.0}, {"factor": "1"}, {"factor": float("nan")}, {"steps": 1.5}, {"steps": True}, {"mode": "divide"}],
)
def test_parameters_are_strict(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        ScaleParameters.model_validate(values)


def test_parameters_need_descriptions() -> None:
    with pytest.raises(TypeError, match="steps has no description"):
        stage(inputs={}, outputs={}, version=1)(_undescribed)


class Undescribed(Parameters):
    steps: int = 1


def _undescribed(context: Context, parameters: Undescribed) -> None:
    """A stage that @stage refuses."""


def test_a_stage_that_is_asked_to_stop_first_says_how_far_it_is(tmp_path: Path) -> None:
    told: list[tuple[float, float]] = []
    asked = False
    services = Services(lambda done, total, figures: told.append((done, total)), stop_requested=lambda: asked)
    context = Context({}, {}, tmp_path, "test", services)
    context.progress_or_stop(1, 2)
    asked = True
    with pytest.raises(Interrupted):
        context.progress_or_stop(2, 2)
    assert told == [(1, 2), (2, 2)]
