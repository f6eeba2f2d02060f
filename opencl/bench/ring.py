"""Places cameras on a circle around a trained scene, roughly where its photos were taken."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.bench.view import View

_UP = (0.0, -1.0, 0.0)
"""Scenes reconstructed from photos have y down, like their cameras."""
_DISTANCE = 1.6
"""Radius of the circle, relative to the distance within which nine tenths of the Gaussians lie."""
_ELEVATION = 0.3
"""Height of the circle above the middle, relative to its radius."""


def ring_of_views(means: Float[Tensor, "N 3"], count: int, width: int, height: int) -> tuple[View, ...]:
    """`count` cameras with a horizontal field of view of 60 degrees on a level circle, facing the scene's median."""
    up = torch.tensor(_UP)
    middle = means.median(dim=0).values
    radius = _DISTANCE * (means - middle).norm(dim=1).quantile(0.9)
    focal = width / (2 * math.tan(math.radians(30)))
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    views = []
    for index in range(count):
        angle = 2 * math.pi * index / count
        outward = torch.tensor([math.cos(angle), 0.0, math.sin(angle)])
        centre = middle + radius * (outward + _ELEVATION * up)
        views.append(View(_look_at(centre, middle, up), intrinsics, width, height))
    return tuple(views)


def _look_at(centre: Float[Tensor, " 3"], target: Float[Tensor, " 3"], up: Float[Tensor, " 3"]) -> Float[Tensor, "4 4"]:
    """The world-to-camera transform of a camera at `centre` that looks at `target`."""
    forward = torch.nn.functional.normalize(target - centre, dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, up), dim=0)
    rotation = torch.stack([right, torch.linalg.cross(forward, right), forward])
    world_to_camera = torch.eye(4)
    world_to_camera[:3, :3] = rotation
    world_to_camera[:3, 3] = -rotation @ centre
    return world_to_camera
