"""Blind reading, without any picture of the message: rendering only Gaussians that hardly belong to the cover.

If a method reveals how much of every Gaussian is the cover's, anyone who knows the method can leave out the cover,
which would hide the messages behind it. Without a seal, the messages then become visible, in false colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.secrecy.observing import Observed
from stages.hiding.left_open import HARDLY
from stages.hiding.method import Method
from stages.hiding.rendering import COVER, splat
from stages.scene.cameras import depths_before
from stages.scene.gaussians import Gaussians

THIN = 0.05
"""Added to the accumulated opacity of the few Gaussians in a pixel before blended values are divided by it."""

Maps = list[Float[Tensor, "H W C"]]


@runtime_checkable
class TellsShares(Protocol):
    """A method whose public part reveals how much of a Gaussian is the cover's."""

    def cover_shares(self, gaussians: Gaussians) -> Float[Tensor, " N"]:
        """The cover's share of each Gaussian, about 0 to 1."""
        ...


def hardly_shown(gaussians: Gaussians, public: TellsShares) -> Gaussians:
    """The Gaussians of which the cover's share is less than `HARDLY`."""
    return gaussians.select(public.cover_shares(gaussians) < HARDLY)


@torch.no_grad()
def feature_maps_of(gaussians: Gaussians, public: Method, views: Sequence[Observed]) -> Maps:
    """The feature map of each view, minus half the opacity, divided by the opacity plus `THIN`; 0 in empty pixels."""
    maps = []
    for seen in views:
        rendering = public.render(gaussians, seen.camera, wanted=(COVER,))
        filled = rendering.alphas[..., None]
        maps.append((rendering.feature_map - filled / 2) / (filled + THIN))
    return maps


@torch.no_grad()
def surfaces_of(gaussians: Gaussians, views: Sequence[Observed]) -> Maps:
    """Three channels without features for each view: mean depth in world units, mean inverse depth, and opacity."""
    maps = []
    for seen in views:
        depths = depths_before(gaussians.means, seen.camera).clamp_min(torch.finfo(torch.float32).eps)
        blended = splat(gaussians, torch.stack([depths, 1 / depths], dim=1), seen.camera)
        filled = blended.alphas[..., None]
        maps.append(torch.cat([blended.feature_map / (filled + THIN), filled], dim=-1))
    return maps
