"""Small trainings on flat pictures: an orange cover and, for methods that hide, a blue message."""

from __future__ import annotations

import numpy as np
import torch

from stages.hiding.method import build_method, settings_of
from stages.hiding.rendering import COVER
from stages.scene.cameras import Cameras, single_cameras
from stages.scene.gaussians import gaussians_at
from stages.training.density_control import DensitySettings
from stages.training.loop import Training, TrainingSettings, TrainingViews
from stages.training.objectives import hiding_terms

WIDTH, HEIGHT = 20, 14
MESSAGE = "message"


def rig(views: int) -> Cameras:
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, 0, 3] = np.linspace(-0.3, 0.3, views)
    intrinsics = np.tile(np.array([[20.0, 0, WIDTH / 2], [0, 20.0, HEIGHT / 2], [0, 0, 1]]), (views, 1, 1))
    return Cameras(tuple(f"{view}.png" for view in range(views)), poses, intrinsics, WIDTH, HEIGHT)


def prepared(
    method_name: str,
    iterations: int,
    seed: int = 0,
    precision: str = "float32",
    density: DensitySettings | None = None,
) -> Training:
    """A training before its first iteration; the same every time, of the same points whatever the seed."""
    torch.manual_seed(seed)
    every = {
        "sh_degree": 1,
        "feature_dim": 8,
        "layers": 2,
        "decoder_width": 8,
        "kernel_size": 3,
        "precision": precision,
    }
    settings: dict[str, object] = {name: every[name] for name in settings_of(method_name)}
    messages = [] if method_name == "plain" else [MESSAGE]
    method = build_method(method_name, settings | ({"messages": messages} if messages else {}))
    generator = np.random.default_rng(seed)
    points = np.random.default_rng(0).uniform([-1, -1, 2], [1, 1, 4], (40, 3))
    colors = {COVER: (230, 120, 40), MESSAGE: (20, 60, 220)}
    pictures = {
        name: torch.tensor(colors[name], dtype=torch.uint8).expand(3, HEIGHT, WIDTH, 3) for name in [COVER, *messages]
    }
    return Training(
        gaussians_at(
            points, method.initial_attributes(dict.fromkeys((COVER, *messages), np.full((40, 3), 0.5)), generator)
        ),
        method,
        TrainingViews(single_cameras(rig(3)), pictures),
        hiding_terms(messages, 0.5),
        TrainingSettings(iterations, extent=1.0, seed=seed, density=density or DensitySettings(maximum_gaussians=60)),
    )
