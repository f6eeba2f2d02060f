"""Attacks on coupled features that the scene decoder can be made to forgive."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import torch
from jaxtyping import Float64
from torch import Tensor

from stages.analysis.attacks.target import FollowsFeatures, Target
from stages.hiding.coupled import FEATURES
from stages.hiding.method import Method
from stages.hiding.stored_features import FARTHEST, stored

ANGLES = (5.0, 15.0, 30.0, 60.0, 90.0)
DROPPED_SHARES = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4)
PERMUTED_SHARES = (1 / 8, 1 / 4, 1 / 2, 3 / 4, 1)


def channel_counts(target: Target) -> Sequence[float]:
    """Of 16 channels 1, 2, 4, 8 and 12; the same shares of others."""
    return _counts(target, DROPPED_SHARES, least=1)


def permuted_counts(target: Target) -> Sequence[float]:
    """Of 16 channels 2, 4, 8, 12 and 16; the same shares of others. One alone cannot change places."""
    return _counts(target, PERMUTED_SHARES, least=2)


def _counts(target: Target, shares: Sequence[float], least: int) -> Sequence[float]:
    channels = target.gaussians[FEATURES].shape[1]
    return sorted({float(max(least, round(share * channels))) for share in shares})


def channel_dropping(target: Target, channels: float, generator: torch.Generator) -> Target:
    """Set so many channels, drawn at random, to their mean over all Gaussians.

    The attacker knows the container alone. Not for containers without features.
    """
    raw = target.gaussians[FEATURES].clone()
    dropped = torch.randperm(raw.shape[1], generator=generator)[: int(channels)]
    raw[:, dropped] = raw[:, dropped].sigmoid().mean(dim=0).logit()
    return target.with_parameters({FEATURES: raw})


def channel_permutation(target: Target, channels: float, generator: torch.Generator) -> Target:
    """Let so many channels, drawn at random, change places in a ring, and the scene decoder read them where they are.

    The attacker knows the container, its scene decoder included. A turn of features that every scene decoder forgives
    to the last bit but those of rounding, whatever the opacity of a pixel. Only for decoders that follow features.
    """
    raw = target.gaussians[FEATURES]
    chosen = torch.randperm(raw.shape[1], generator=generator)[: int(channels)]
    order = torch.arange(raw.shape[1])
    order[chosen] = chosen.roll(1)
    places = torch.eye(raw.shape[1], dtype=torch.float64)[order]
    return replace(target.with_parameters({FEATURES: raw[:, order]}), method=_reading(target.method, places.T))


def feature_rotation(target: Target, degrees: float, generator: torch.Generator) -> Target:
    """Turn all activated features about 0.5 by so many degrees, in M/2 planes of a random basis.

    The attacker knows the container alone and leaves the scene decoder as it is: the cover is lost as well. Values
    that would leave (0, 1) stop short of it. Not for containers without features.
    """
    centred = target.gaussians[FEATURES].double().sigmoid() - 0.5
    return target.with_parameters({FEATURES: stored(0.5 + centred @ _turn(centred.shape[1], degrees, generator).T)})


def compensated_rotation(target: Target, degrees: float, generator: torch.Generator) -> Target:
    """The same, and the scene decoder turned with it: its first layer reads the turned features as it read the old.

    The attacker knows the container, its scene decoder included. Features are drawn towards 0.5 where they would leave
    (0, 1), and the decoder reads them by as much longer rows. For `homogeneous` nothing of the cover changes, which is
    read from features less half the blended opacity. GS-Hider's decoder reads the blended features themselves: what is
    exact where the opacity is 1 is not where it is less, nor beside the picture's border, with zeros beyond it. Only
    for decoders that follow features.
    """
    centred = target.gaussians[FEATURES].double().sigmoid() - 0.5
    turn = _turn(centred.shape[1], degrees, generator)
    return shrunk(target, centred @ turn.T, turn.T)


def reads_centred(method: Method) -> bool:
    """Whether the scene decoder reads features less half the opacity, so that a common factor can be made good."""
    return cast(FollowsFeatures, method.networks["scene_decoder"]).reads_centred


def shrunk(target: Target, centred: Float64[Tensor, "N M"], back: Float64[Tensor, "M M"]) -> Target:
    """Features 0.5 + s c, and a scene decoder with rows r B / s, where it had r; B is `back`.

    s is the largest factor up to 1 that leaves all features storable.
    """
    farthest = float(centred.abs().max()) if len(centred) else 0.0
    shrink = min(1.0, FARTHEST / max(farthest, FARTHEST))
    changed = target.with_parameters({FEATURES: stored(0.5 + shrink * centred)})
    return replace(changed, method=_reading(target.method, back / shrink))


def _reading(method: Method, back: Float64[Tensor, "M M"]) -> Method:
    """The method with a scene decoder that reads features, centred at 0.5, along r B where it read them along r."""
    changed = copy.deepcopy(method)
    cast(FollowsFeatures, changed.networks["scene_decoder"]).read_along(back)
    return changed


def _turn(channels: int, degrees: float, generator: torch.Generator) -> Float64[Tensor, "M M"]:
    """A rotation by the angle in each of M/2 planes at right angles; an odd last direction stays."""
    basis = torch.linalg.qr(torch.randn(channels, channels, generator=generator, dtype=torch.float64)).Q
    angle = torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))
    turned = torch.eye(channels, dtype=torch.float64)
    for first in range(0, channels - 1, 2):
        turned[first, first] = turned[first + 1, first + 1] = angle.cos()
        turned[first, first + 1], turned[first + 1, first] = -angle.sin(), angle.sin()
    return basis @ turned @ basis.T
