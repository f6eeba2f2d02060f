"""Blind reading, without any picture of the message: what the feature map shows besides the cover.

An attacker with only the container knows its scene decoder, and therefore which part of the features is the cover's.
The rest is viewed directly, three channels at a time, in false colours. Nothing here has access to a message.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from stages.analysis.random_signs import random_signs
from stages.analysis.secrecy.apart import Maps, TellsShares, feature_maps_of, hardly_shown, surfaces_of
from stages.analysis.secrecy.conditions import (
    APART,
    CHANNELS,
    COMPONENTS,
    HEEDED,
    IGNORED,
    SHOWN,
    SURFACES,
    UNEXPLAINED,
)
from stages.analysis.secrecy.linear import covariance, least_squares, neighbourhoods
from stages.analysis.secrecy.observing import Observed
from stages.hiding.coupled import CoupledFeatures
from stages.hiding.method import Method
from stages.scene.gaussians import Gaussians

PROBES = 4
"""How many random directions of the scene decoder's output estimate its sensitivity in each view."""

SMALLEST_SENSITIVITY = 1e-3
"""Regularises the sensitivity, as a share of its mean over all directions: less is as good as none."""


def blind_readings(gaussians: Gaussians, public: Method, views: Sequence[Observed], seed: int) -> dict[str, Maps]:
    """Readings of three channels for every view, by method of reading; missing channels are zero.

    - CHANNELS: the first three of the feature map; the paper shows three at random.
    - COMPONENTS: its first principal components.
    - UNEXPLAINED: those of its residual after regression on the cover's picture with 3 x 3 neighbours.

    With a scene decoder, whose random probes `seed` determines:

    - IGNORED: directions with the largest variance of features relative to the scene decoder's sensitivity.

    If the method also reveals how much of a Gaussian is the cover's, from `hardly_shown` Gaussians alone:

    - APART: the same as IGNORED.
    - HEEDED: principal components weighted by the scene decoder's sensitivity, which no seal encrypts.
    - SURFACES: their depths and opacity (`surfaces_of`).
    """
    maps = [seen.rendering.feature_map for seen in views]
    readings = {
        CHANNELS: [each[..., :SHOWN] for each in maps],
        COMPONENTS: _along(maps, principal_directions(maps)),
        UNEXPLAINED: _unexplained(maps, [seen.cover for seen in views]),
    }
    if isinstance(public, CoupledFeatures):
        sensitivities = sensitivity(public, views, seed)
        readings[IGNORED] = _along(maps, ignored_directions(maps, sensitivities))
        if isinstance(public, TellsShares):
            few = hardly_shown(gaussians, public)
            maps = feature_maps_of(few, public, views)
            readings[APART] = _along(maps, ignored_directions(maps, sensitivities))
            readings[HEEDED] = _along(maps, heeded_directions(maps, sensitivities))
            readings[SURFACES] = surfaces_of(few, views)
    return {name: [pad(each, (0, SHOWN - each.shape[-1])) for each in found] for name, found in readings.items()}


def principal_directions(maps: Sequence[Float[Tensor, "H W M"]]) -> Float[Tensor, "M C"]:
    """The first three principal directions by descending variance, or as many as there are channels."""
    _, directions = torch.linalg.eigh(covariance(maps))
    return directions.flip(1)[:, :SHOWN].float()


def sensitivity(public: CoupledFeatures, views: Sequence[Observed], seed: int) -> Float[Tensor, "M M"]:
    """JᵀJ of the scene decoder, averaged over pixels: how much its picture changes along each feature direction.

    Estimated from gradients of randomly signed sums of its output; products between pixels cancel on average.
    """
    generator = torch.Generator().manual_seed(seed)
    size = views[0].rendering.feature_map.shape[-1]
    total, pixels = torch.zeros(size, size, dtype=torch.float64), 0
    for seen in views:
        for _ in range(PROBES):
            gradient = _gradient_of_random_sum(public, seen, generator).reshape(-1, size).double()
            total += gradient.T @ gradient
            pixels += len(gradient)
    return total / pixels


def ignored_directions(
    maps: Sequence[Float[Tensor, "H W M"]], sensitivities: Float[Tensor, "M M"]
) -> Float[Tensor, "M C"]:
    """Up to three directions by descending ratio of variance to sensitivity: generalised eigenvectors of the two."""
    size = len(sensitivities)
    floor = SMALLEST_SENSITIVITY * sensitivities.diagonal().mean() * torch.eye(size, dtype=torch.float64)
    values, vectors = torch.linalg.eigh(sensitivities + floor)
    whitening = vectors * values.rsqrt()
    _, directions = torch.linalg.eigh(whitening.T @ covariance(maps) @ whitening)
    return (whitening @ directions.flip(1)[:, :SHOWN]).float()


def heeded_directions(
    maps: Sequence[Float[Tensor, "H W M"]], sensitivities: Float[Tensor, "M M"]
) -> Float[Tensor, "M C"]:
    """Up to three directions along which features differ most, weighted by the scene decoder's mean sensitivity."""
    values, vectors = torch.linalg.eigh(sensitivities)
    weighing = (vectors * values.clamp_min(0).sqrt()).float()
    return weighing @ principal_directions([each @ weighing for each in maps])


def stretched(maps: Maps) -> Maps:
    """Each channel stretched, over all maps together, so that its middle 98 % fill [0, 1]; a constant one is grey."""
    pixels = torch.cat([each.reshape(-1, each.shape[-1]) for each in maps])
    ordered = pixels.sort(dim=0).values
    low, high = ordered[len(ordered) // 100], ordered[-1 - len(ordered) // 100]
    span = torch.where(high > low, high - low, torch.ones_like(high))
    offset = torch.where(high > low, low, low - 0.5)
    return [((each - offset) / span).clamp(0, 1) for each in maps]


def _along(maps: Sequence[Float[Tensor, "H W M"]], directions: Float[Tensor, "M C"]) -> Maps:
    return [each @ directions for each in maps]


def _unexplained(maps: Sequence[Float[Tensor, "H W M"]], covers: Sequence[Float[Tensor, "H W 3"]]) -> Maps:
    explained = least_squares(map(neighbourhoods, covers), maps)
    rest = [each - neighbourhoods(cover) @ explained for each, cover in zip(maps, covers, strict=True)]
    return _along(rest, principal_directions(rest))


def _gradient_of_random_sum(
    public: CoupledFeatures, seen: Observed, generator: torch.Generator
) -> Float[Tensor, "H W M"]:
    feature_map = seen.rendering.feature_map.detach().clone().requires_grad_()
    [decoded] = public.decoded([public.scene_decoder], seen.with_feature_map(feature_map).rendering, seen.camera)
    [gradient] = torch.autograd.grad((decoded * random_signs(decoded, generator)).sum(), feature_map)
    return gradient
