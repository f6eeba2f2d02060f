"""A cloud of coloured Gaussians with enough detail for pictures of it to be recognised, and a rig around it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from stages.hiding.method import Method, build_method
from stages.hiding.rendering import COVER
from stages.hiding.watermark.rendering import renders
from stages.imaging.pictures import Picture
from stages.scene.cameras import Cameras
from stages.scene.gaussians import Gaussians, gaussians_at
from stages.tracing.rig import orbit

WIDTH, HEIGHT, VIEWS = 128, 96, 32


def cloud(seed: int = 0, count: int = 2500) -> tuple[Gaussians, Method]:
    """Opaque spots of all colours within a ball of radius 1."""
    generator = np.random.default_rng(seed)
    method = build_method("plain", {"sh_degree": 0})
    directions = generator.normal(size=(count, 3))
    points = directions / np.linalg.norm(directions, axis=1, keepdims=True) * generator.uniform(0.7, 1, (count, 1))
    colours = {COVER: generator.uniform(0.05, 0.95, (count, 3))}
    gaussians = gaussians_at(points.astype(np.float32), method.initial_attributes(colours, generator))
    sizes = generator.uniform(np.log(0.02), np.log(0.06), (count, 3))
    changed = {
        "log_scales": torch.from_numpy(sizes).float(),
        "logit_opacities": torch.full((count,), 3.0),
    }
    return gaussians.with_parameters(changed), method


def rig(seed: int = 1, views: int = VIEWS) -> Cameras:
    """Cameras all around, named by their numbers."""
    poses, intrinsics = orbit(views, WIDTH, HEIGHT, seed=seed)
    return Cameras(tuple(str(view) for view in range(views)), poses, intrinsics, WIDTH, HEIGHT)


def beside(cameras: Cameras, degrees: float = 4.0, step: float = 0.1) -> Cameras:
    """One camera: the middle one of the rig, turned and moved a little to where no camera of the rig stands."""
    moved = np.eye(4)
    moved[:3, :3] = Rotation.from_euler("xyz", [degrees, -degrees, degrees], degrees=True).as_matrix()
    moved[:3, 3] = step, -step, step
    middle = cameras.select([cameras.names[len(cameras) // 2]])
    return replace(middle, world_to_camera=moved @ middle.world_to_camera)


def photograph(gaussians: Gaussians, method: Method, camera: Cameras) -> Picture:
    """The 8-bit picture that a single camera sees."""
    return renders(gaussians, method, camera, lambda: None)[0]
