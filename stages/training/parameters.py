"""Parameters common to all training stages."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Parameters
from stages.training.density_control import DensitySettings
from stages.training.loop import TrainingSettings
from stages.training.starting_points import Start
from stages.training.threads import Threads


class TrainingParameters(Parameters):
    """Constants of the optimisation. Defaults are 3DGS's, except for `maximum_gaussians`, which it does not have."""

    iterations: int = Field(30_000, ge=1, description="Optimisation steps, one view each; schedules scale with it.")
    schedule_share: float = Field(
        1.0,
        gt=0,
        le=1,
        description="Share of the iterations covered by 3DGS's schedules. Released code: 0.6, 30,000 of 50,000.",
    )
    averaging: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="Decay of the exponential moving average of Gaussians and networks over the last fifth of the "
        "iterations, which becomes the result; 0, as in 3DGS and the paper: none. homogeneous: 0.995.",
    )
    opacity_weight: float = Field(
        0.0,
        ge=0,
        description="Weight of the Gaussians' mean opacity in the loss, over all training views together; 0, as in "
        "3DGS and the paper: none. homogeneous: 2. Any other than 0 takes the place of 3DGS's opacity resets, after "
        "which it prunes large Gaussians; with 0, these happen if the schedules (schedule_share) take at least 15,000 "
        "iterations.",
    )
    scale_weight: float = Field(
        0.0, ge=0, description="Weight of their mean scale, as a share of the rig's extent, likewise. homogeneous: 2."
    )
    seed: int = Field(
        0,
        ge=0,
        description="Random seed for view order, splitting and random starting points and, without a key, for the "
        "networks' initial weights and where messages lie in features.",
    )
    threads: Threads = 1
    position_rate: float = Field(
        TrainingSettings.position_rate,
        gt=0,
        description="Initial learning rate of positions, multiplied by the rig's extent.",
    )
    final_position_rate: float = Field(
        TrainingSettings.final_position_rate, gt=0, description="Final learning rate of positions, likewise."
    )
    densify_gradient: float = Field(
        DensitySettings.gradient_threshold,
        gt=0,
        description="Mean screen-space gradient above which a Gaussian is densified.",
    )
    maximum_gaussians: int = Field(
        DensitySettings.maximum_gaussians,
        ge=1,
        description="Number of Gaussians beyond which density control adds no more, to limit memory; the log says when "
        "it first applies. 3DGS and the paper: no limit.",
    )
    sparse_points: bool = Field(True, description="Start with a Gaussian on every sparse point.")
    random_points: int = Field(
        0, ge=0, description="Number of grey Gaussians to add at the start, at random in front of the cameras."
    )

    def start(self, message_points: int = 0) -> Start:
        """Where the first Gaussians are placed."""
        return Start(self.sparse_points, message_points, self.random_points, self.seed)

    def settings(self, extent: float) -> TrainingSettings:
        """The loop's settings for a rig of this extent."""
        return TrainingSettings(
            iterations=self.iterations,
            extent=extent,
            seed=self.seed,
            schedule_share=self.schedule_share,
            averaging=self.averaging,
            opacity_weight=self.opacity_weight,
            scale_weight=self.scale_weight,
            position_rate=self.position_rate,
            final_position_rate=self.final_position_rate,
            density=DensitySettings(gradient_threshold=self.densify_gradient, maximum_gaussians=self.maximum_gaussians),
        )
