"""The cheapest surrogate: least squares from feature maps to the pictures that leaked, in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.secrecy.linear import least_squares, neighbourhoods
from stages.analysis.secrecy.observing import Observed


def linear_surrogate(seen: Sequence[Observed], views: Sequence[Observed]) -> list[Float[Tensor, "L H W 3"]]:
    """The messages in `views`, by the linear map that fits the `seen` views best, without any randomness.

    It maps each pixel's 3 x 3 neighbours in all channels of the feature map, and so shows how openly the features hold
    the message. Raises `ValueError` if no view was seen.
    """
    targets = (_channels(each.truths) for each in seen)
    weights = least_squares((neighbourhoods(each.rendering.feature_map) for each in seen), targets)
    shown = [neighbourhoods(each.rendering.feature_map) @ weights for each in views]
    return [torch.stack(channels.split(3, dim=-1)) for channels in shown]


def _channels(truths: Float[Tensor, "L H W 3"]) -> Float[Tensor, "H W C"]:
    return torch.cat(list(truths), dim=-1)
