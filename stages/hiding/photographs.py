"""Rendering trained Gaussians from many cameras, one at a time, without gradients."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch

from stages.hiding.method import Method
from stages.hiding.rendering import COVER, Rendering
from stages.scene.cameras import Cameras, single_cameras
from stages.scene.gaussians import Gaussians


def photographs(
    gaussians: Gaussians, method: Method, cameras: Cameras, public: Gaussians | None = None
) -> Iterator[Rendering]:
    """Yield a rendering for every camera, in the rig's order; only one is held at a time.

    `public` are the Gaussians from which the cover is rendered if `gaussians` were opened with a secret. Otherwise the
    cover's picture would depend on the message: by rounding in an honest container, visibly in one made for that
    purpose.
    """
    for camera in single_cameras(cameras):
        with torch.no_grad():
            rendering = method.render(gaussians, camera, wanted=method.messages if public is not None else None)
            if public is not None:
                cover = method.render(public, camera, wanted=(COVER,)).pictures[COVER]
                messages = {name: rendering.pictures[name] for name in method.messages}
                rendering = replace(rendering, pictures={COVER: cover, **messages})
        yield rendering
