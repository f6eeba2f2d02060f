"""`train_scene`: plain 3D Gaussian Splatting of one scene (3DGS with spherical harmonics and density control)."""

from __future__ import annotations

import numpy as np
import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.stage import Context, Input, Output, stage
from stages.hiding.method import build_method
from stages.hiding.method_names import PLAIN, module_of
from stages.hiding.storage import write_container
from stages.imaging.metric_table import write_rows
from stages.scene.cameras import rig_extent
from stages.scene.gaussians import gaussians_at
from stages.scene.scene import read_scene
from stages.scene.world_scale import stated, world_scale_of
from stages.training.loop import Training
from stages.training.objectives import cover_term
from stages.training.parameters import TrainingParameters
from stages.training.session import train
from stages.training.starting_points import starting_points
from stages.training.views import training_views


class TrainSceneParameters(TrainingParameters):
    """Parameters of 3DGS."""

    sh_degree: int = Field(3, ge=0, le=3, description="Highest degree of the spherical harmonics.")
    ssim_weight_cover: float = Field(0.2, ge=0, le=1, description="γ: SSIM's share of the loss.")


@stage(
    inputs={"scene": Input("scene")},
    outputs={"splats": Output("splats"), "curves": Output("metrics")},
    version=1,
    modules=lambda parameters: [module_of(PLAIN)],
)
def train_scene(context: Context, parameters: TrainSceneParameters) -> None:
    """Train splats on a scene's training views; test views are never seen."""
    torch.set_num_threads(parameters.threads)
    scene = read_scene(context.input("scene"))
    method = build_method(PLAIN, {"sh_degree": parameters.sh_degree})
    points, colors = starting_points(scene, {}, parameters.start())
    generator = np.random.default_rng(parameters.seed)
    training = Training(
        gaussians_at(points, method.initial_attributes(colors, generator)).to(working_device()),
        method,
        training_views(scene),
        [cover_term(parameters.ssim_weight_cover)],
        parameters.settings(rig_extent(scene.cameras)),
    )
    curves = train(context, training)
    write_container(context.output("splats"), training.gaussians, method)
    context.output("splats").attributes.update(stated(world_scale_of(context.input("scene"))))
    write_rows(context.output("curves"), curves)
    context.record(device=describe_drawing(training.device), gaussians=len(training.gaussians))
