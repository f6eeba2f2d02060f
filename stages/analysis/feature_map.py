"""The feature map as a picture, for methods that have one."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from stages.hiding.coupled import FEATURES
from stages.hiding.rendering import Rendering
from stages.scene.gaussians import Gaussians

CHANNELS = 3
"""The first channels, shown as red, green and blue; the paper's figure of the feature map shows three at random."""


def feature_map_picture(gaussians: Gaussians, rendering: Rendering) -> Float[Tensor, "H W 3"] | None:
    """The first three channels of the feature map; missing channels are black.

    None if the Gaussians have no coupled features: the rasterizer then blends the pictures themselves.
    """
    if FEATURES not in gaussians.parameters:
        return None
    shown = rendering.feature_map[..., :CHANNELS]
    return functional.pad(shown, (0, CHANNELS - shown.shape[-1]))
