"""What the log of a training says."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.stage import Services, run_stage
from stages.train_scene import TrainSceneParameters, train_scene
from tests.stages import small

ITERATIONS = 400
"""Density control refines several times."""


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
