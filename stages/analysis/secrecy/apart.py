"""Reading without a single picture of the message: Gaussians that the cover hardly shows are rendered by themselves.

Where a method says of every Gaussian how much of it is the cover's, whoever knows the method need not look through the
cover: what stands in front of the messages is left out. Without a seal the messages lie open then, in false colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.secrecy.observing import Observed
from stages.hiding.method import Method
from stages.hiding.rendering import COVER, splat
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import chosen

HARDLY = 0.1
"""Of the cover. With 0.25 and 0.5 the fox's message showed less: r = 0.82 and 0.70 instead of 0.84."""

THIN = 0.05
"""Added to how much of a pixel the few Gaussians fill before what is blended of them is divided by it."""

Maps = list[Float[Tensor, "H W C"]]


@runtime_checkable
class TellsShares(Protocol):
    """A method whose public part says how much of a Gaussian is the cover's."""

    def cover_shares(self, gaussians: Gaussians) -> Float[Tensor, " N"]:
        """About 0 to 1 each."""
        ...


def hardly_shown(gaussians: Gaussians, public: TellsShares) -> Gaussians:
    """Those of which less than `HARDLY` is the cover's."""
    return chosen(gaussians, public.cover_shares(gaussians) < HARDLY)


@torch.no_grad()
def feature_maps_of(gaussians: Gaussians, public: Method, views: Sequence[Observed]) -> Maps:
    """The feature map of each view, centred and divided by how much of each pixel is filled; 0 where nothing is."""
    maps = []
    for seen in views:
        rendering = public.render(gaussians, seen.camera, wanted=(COVER,))
        filled = rendering.alphas[..., None]
        maps.append((rendering.feature_map - filled / 2) / (filled + THIN))
    return maps


@torch.no_grad()
def surfaces_of(gaussians: Gaussians, views: Sequence[Observed]) -> Maps:
    """Of each pixel the blended depth, in world units, its reciprocal, and how much of it is filled: no features."""
    maps = []
    for seen in views:
        towards = seen.camera.world_to_camera[2]
        depths = (gaussians.means @ towards[:3] + towards[3]).clamp_min(torch.finfo(torch.float32).eps)
        blended = splat(gaussians, torch.stack([depths, 1 / depths], dim=1), seen.camera)
        filled = blended.alphas[..., None]
        maps.append(torch.cat([blended.feature_map / (filled + THIN), filled], dim=-1))
    return maps
