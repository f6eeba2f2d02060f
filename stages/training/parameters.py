"""Parameters that every training stage has, and the points from which its Gaussians start."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field

from pipeline.errors import UserError
from pipeline.stage import Parameters
from stages.scene.scene import Scene
from stages.training.density_control import DensitySettings
from stages.training.loop import TrainingSettings

GREY = 0.5
BOX_PERCENTILES = (2, 98)


class TrainingParameters(Parameters):
    """Constants of the optimisation; the defaults are those of 3DGS."""

    iterations: int = Field(30_000, ge=1, description="Optimisation steps, one view each; schedules scale with it.")
    seed: int = Field(0, ge=0, description="Of the order of views, of splitting, and of the networks' first weights.")
    threads: int = Field(1, ge=1, description="Threads of torch: sums over pixels, and so the bits, depend on it.")
    position_rate: float = Field(1.6e-4, gt=0, description="First learning rate of positions, times the rig's extent.")
    final_position_rate: float = Field(1.6e-6, gt=0, description="Last learning rate of positions, likewise.")
    densify_gradient: float = Field(2e-4, gt=0, description="Mean screen-space gradient above which one is refined.")
    maximum_gaussians: int = Field(1_000_000, ge=1, description="Density control adds none beyond these.")
    initial_points: Literal["sfm", "random"] = Field(
        "sfm", description="Start on the sparse points, or on grey random ones in their bounding box."
    )
    random_points: int = Field(20_000, ge=1, description="How many, where initial_points is random.")

    def settings(self, extent: float) -> TrainingSettings:
        """The loop's settings for a rig of this extent."""
        return TrainingSettings(
            iterations=self.iterations,
            extent=extent,
            seed=self.seed,
            position_rate=self.position_rate,
            final_position_rate=self.final_position_rate,
            density=DensitySettings(gradient_threshold=self.densify_gradient, maximum_gaussians=self.maximum_gaussians),
        )


def starting_points(
    scene: Scene, parameters: TrainingParameters
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Positions in world units and colours in [0, 1] of the first Gaussians.

    Raises `UserError` for a scene without points when they are asked for.
    """
    if len(scene.points) == 0:
        raise UserError(
            "the scene has no sparse points to start from",
            found="0 points",
            expected="at least one",
            remedy="check the capture's poses, or photograph with more overlap",
        )
    if parameters.initial_points == "sfm":
        return scene.points.astype(np.float64), scene.point_colors / 255
    generator = np.random.default_rng(parameters.seed)
    lowest, highest = np.percentile(scene.points, BOX_PERCENTILES, axis=0)
    points = generator.uniform(lowest, highest, size=(parameters.random_points, 3))
    return points, np.full_like(points, GREY)
