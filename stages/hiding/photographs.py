"""Rendering trained Gaussians from many cameras, one at a time, without gradients."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import torch

from stages.hiding.method import Method
from stages.hiding.rendering import Rendering
from stages.scene.cameras import Cameras, single_cameras
from stages.scene.gaussians import Gaussians


def photographs(
    gaussians: Gaussians, method: Method, cameras: Cameras, wanted: Collection[str] | None = None
) -> Iterator[Rendering]:
    """Yield a rendering for every camera, in the rig's order; only one is held at a time.

    `wanted`: the names of the pictures, or None for all, as in `Method.render`.
    """
    for camera in single_cameras(cameras):
        with torch.no_grad():
            rendering = method.render(gaussians, camera, wanted=wanted)
        yield rendering
