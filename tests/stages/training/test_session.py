"""A training that diverges, has no Gaussians left, or is limited in growth: its errors and its log."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest
import torch

from opencl.memory import TorchMemory
from pipeline.errors import UserError
from pipeline.stage import Services
from stages.scene.gaussians import Gaussians
from stages.train_scene import TrainSceneParameters, train_scene
from stages.training.divergence import refuse_divergence
from stages.training.loop import Training
from tests.running import run_stage
from tests.stages import small
from tests.stages.training.trainings import prepared

ITERATIONS = 400
"""Density control refines several times."""


def test_a_training_that_diverges_ends_at_once() -> None:
    """With an error that says where, and not with a container full of NaN."""
    training = prepared("gs_hider", 10)
    training.step(1)
    with torch.no_grad():
        next(training.method.networks["scene_decoder"].parameters()).fill_(torch.nan)
    with pytest.raises(UserError, match="iteration 2: the training has diverged; found a loss of nan"):
        training.step(2)


@pytest.mark.parametrize("loss", [math.nan, math.inf, -math.inf])
def test_a_loss_that_is_not_finite_is_refused(loss: float) -> None:
    with pytest.raises(UserError, match=f"iteration 7: the training has diverged; found a loss of {loss}"):
        refuse_divergence(loss, 7)
    refuse_divergence(sys.float_info.max, 7)


@pytest.mark.parametrize(("name", "value"), [("means", math.nan), ("log_scales", math.inf), ("raw_features", math.nan)])
def test_a_gaussian_that_is_not_finite_is_refused_although_no_picture_shows_it(name: str, value: float) -> None:
    training = prepared("gs_hider", 2)
    training.step(1)
    training.iteration = 1
    with torch.no_grad():
        training.gaussians[name][3].fill_(value)
    expected = f"Gaussians' {name}: the training has diverged; found NaN or infinity in 1 of {len(training.gaussians)}"
    with pytest.raises(UserError, match=expected):
        training.run(lambda: None)


def test_nothing_is_left_to_hold_back_where_no_gaussians_are() -> None:
    """Density control may prune all Gaussians, and a mean over none is NaN."""
    training = prepared("homogeneous", 10)
    assert training.method.penalty(training.gaussians) is not None
    none = {name: values[:0] for name, values in training.gaussians.parameters.items()}
    assert training.method.penalty(Gaussians(none)) is None


def test_a_gpu_that_is_too_small_is_told_with_what_to_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = Training.step

    def step(training: Training, iteration: int) -> dict[str, float]:
        if iteration == 4:  # as the rasterizer asks for memory, and says what it lacks
            monkeypatch.setattr(torch, "empty", full)
            TorchMemory(torch.device("cuda")).empty(3, dtype=torch.float32)
        return steps(training, iteration)

    def full(*_: object, **__: object) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.")

    monkeypatch.setattr(Training, "step", step)
    inputs = {"scene": small.scene(tmp_path / "scene")}
    with pytest.raises(
        UserError, match=r"too little memory .* pictures of \d+ x \d+; cuda: CUDA out of memory.*2.00 GiB"
    ) as told:
        run_stage(train_scene, TrainSceneParameters(iterations=9), inputs, tmp_path / "out")
    assert str(told.value).startswith("iteration 4: ")
    assert "--workers 1" in str(told.value)


@pytest.mark.parametrize(("maximum", "told"), [(70, 1), (1_000_000, 0)])
def test_a_bound_on_gaussians_that_limits_growth_is_told_once(tmp_path: Path, maximum: int, told: int) -> None:
    parameters = TrainSceneParameters(
        iterations=ITERATIONS, sh_degree=0, densify_gradient=1e-6, maximum_gaussians=maximum
    )
    log: list[str] = []
    inputs = {"scene": small.scene(tmp_path / "scene")}
    run_stage(train_scene, parameters, inputs, tmp_path / "out", services=Services(log=log.append))
    lines = [line for line in log if "maximum_gaussians" in line]
    assert len(lines) == told
    assert all(line.startswith(f"growth is limited to maximum_gaussians, {maximum}, from iteration ") for line in lines)
