"""Attacks on coupled features, some of which adapt the scene decoder to the change."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import torch
from jaxtyping import Float64, Int
from torch import Tensor

from stages.analysis.attacks.target import FollowsFeatures, Target
from stages.hiding.coupled import FEATURES
from stages.hiding.method import Method
from stages.hiding.networks import SCENE_DECODER
from stages.hiding.stored_features import FARTHEST, stored

ANGLES = (5.0, 15.0, 30.0, 60.0, 90.0)
DROPPED_SHARES = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4)
PERMUTED_SHARES = (1 / 8, 1 / 4, 1 / 2, 3 / 4, 1)
MIXED_SHARES = (0.05, 0.1, 0.2, 0.3, 0.4)
"""Shares of another channel; with 0.5, the scene decoder could no longer be adapted to an even number of channels."""


def channel_counts(target: Target) -> Sequence[float]:
    """How many channels to drop: 1, 2, 4, 8 and 12 of 16, and the same shares of other numbers of channels."""
    return _counts(target, DROPPED_SHARES, least=1)


def permuted_counts(target: Target) -> Sequence[float]:
    """How many channels to permute: 2, 4, 8, 12 and 16 of 16, and the same shares of other numbers; at least two."""
    return _counts(target, PERMUTED_SHARES, least=2)


def _counts(target: Target, shares: Sequence[float], least: int) -> Sequence[float]:
    channels = target.gaussians[FEATURES].shape[1]
    return sorted({float(max(least, round(share * channels))) for share in shares})


def channel_dropping(target: Target, channels: float, generator: torch.Generator) -> Target:
    """Set this many random channels of the activated features to their mean over all Gaussians.

    The attacker knows only the container. The container must have features.
    """
    raw = target.gaussians[FEATURES].clone()
    dropped = torch.randperm(raw.shape[1], generator=generator)[: int(channels)]
    raw[:, dropped] = raw[:, dropped].sigmoid().mean(dim=0).logit()
    return target.with_parameters({FEATURES: raw})


def channel_permutation(target: Target, channels: float, generator: torch.Generator) -> Target:
    """Permute this many random channels cyclically, and the scene decoder's inputs with them.

    The attacker knows the container, including its scene decoder. The permutation leaves the cover unchanged up to
    rounding, with every scene decoder and whatever a pixel's opacity. The decoder must be a `FollowsFeatures`.
    """
    raw = target.gaussians[FEATURES]
    order = _cycle(raw.shape[1], int(channels), generator)
    places = torch.eye(raw.shape[1], dtype=torch.float64)[order]
    return replace(target.with_parameters({FEATURES: raw[:, order]}), method=_reading(target.method, places.T))


def feature_mixing(target: Target, share: float, generator: torch.Generator) -> Target:
    """Replace this share of every activated channel by the next channel of a random cycle through all of them.

    The attacker knows the container, including its scene decoder, whose rows r become r B⁻¹ with
    B = (1 - share) I + share P, P a permutation. Features stay in (0, 1), and the rows of B sum to 1: the cover does
    not change, with every scene decoder and whatever a pixel's opacity. A `share` below 0.5 can always be undone. A
    single channel stays as it is. The decoder must be a `FollowsFeatures`.
    """
    activated = target.gaussians[FEATURES].double().sigmoid()
    channels = activated.shape[1]
    unit = torch.eye(channels, dtype=torch.float64)
    mixing = (1 - share) * unit + share * unit[_cycle(channels, channels, generator)]
    mixed = target.with_parameters({FEATURES: stored(activated @ mixing.T)})
    return replace(mixed, method=_reading(target.method, torch.linalg.inv(mixing)))


def feature_rotation(target: Target, degrees: float, generator: torch.Generator) -> Target:
    """Rotate all activated features about 0.5 by this many degrees, in M/2 planes of a random basis.

    The attacker knows only the container and leaves the scene decoder as it is, so the cover is lost as well. Values
    that would leave (0, 1) are clamped just inside it. The container must have features.
    """
    centred = target.gaussians[FEATURES].double().sigmoid() - 0.5
    return target.with_parameters({FEATURES: stored(0.5 + centred @ _turn(centred.shape[1], degrees, generator).T)})


def compensated_rotation(target: Target, degrees: float, generator: torch.Generator) -> Target:
    """Rotate the features as `feature_rotation` does, and the scene decoder's first layer with them.

    The attacker knows the container, including its scene decoder. If some features would leave (0, 1), all are shrunk
    towards 0.5, and the decoder's rows grow by the same factor. With `homogeneous`, whose decoder reads features minus
    half the blended opacity, the cover does not change. GS-Hider's decoder reads the blended features themselves: the
    compensation is exact only where the opacity is 1, and not near the picture's border, where the convolutions pad
    with zeros. So this attack costs GS-Hider's cover much by itself; `feature_mixing` costs it nothing. The decoder
    must be a `FollowsFeatures`.
    """
    centred = target.gaussians[FEATURES].double().sigmoid() - 0.5
    turn = _turn(centred.shape[1], degrees, generator)
    return shrunk(target, centred @ turn.T, turn.T)


def reads_centred(method: Method) -> bool:
    """Whether the scene decoder reads features minus half the opacity, so that it can undo a common factor."""
    return cast(FollowsFeatures, method.networks[SCENE_DECODER]).reads_centred


def shrunk(target: Target, centred: Float64[Tensor, "N M"], back: Float64[Tensor, "M M"]) -> Target:
    """A target with features 0.5 + s c, and with rows r B / s in the scene decoder in place of r.

    c is `centred`, B is `back`, and s is the largest factor up to 1 with which all features can be stored.
    """
    farthest = float(centred.abs().max()) if len(centred) else 0.0
    shrink = min(1.0, FARTHEST / max(farthest, FARTHEST))
    changed = target.with_parameters({FEATURES: stored(0.5 + shrink * centred)})
    return replace(changed, method=_reading(target.method, back / shrink))


def _reading(method: Method, back: Float64[Tensor, "M M"]) -> Method:
    """A copy of the method whose scene decoder applies rows r B to features, centred at 0.5, in place of rows r."""
    changed = copy.deepcopy(method)
    cast(FollowsFeatures, changed.networks[SCENE_DECODER]).read_along(back)
    return changed


def _cycle(channels: int, moved: int, generator: torch.Generator) -> Int[Tensor, " M"]:
    """An order of all channels in which so many random ones change places in a cycle, and the others stay."""
    chosen = torch.randperm(channels, generator=generator)[:moved]
    order = torch.arange(channels)
    order[chosen] = chosen.roll(1)
    return order


def _turn(channels: int, degrees: float, generator: torch.Generator) -> Float64[Tensor, "M M"]:
    """A rotation by this angle in each of ⌊M/2⌋ random, mutually orthogonal planes."""
    basis = torch.linalg.qr(torch.randn(channels, channels, generator=generator, dtype=torch.float64)).Q
    angle = torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))
    turned = torch.eye(channels, dtype=torch.float64)
    for first in range(0, channels - 1, 2):
        turned[first, first] = turned[first + 1, first + 1] = angle.cos()
        turned[first, first + 1], turned[first + 1, first] = -angle.sin(), angle.sin()
    return basis @ turned @ basis.T
