"""Unmixing: fitting the map from rotated, permuted or thinned features back to the published ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float64
from torch import Tensor

CONCENTRATIONS = 5
SPREADS = 4.0
"""In the final fit, a pair counts if its distance from the map is at most this many medians."""

SMALLEST_VARIANCE = 1e-12
"""Relative to the largest: combinations of channels with less variance are ignored."""

AS_PUBLISHED = 1e-3
"""Features at most this far from the published ones count as unchanged."""

NO_NEARER = 1.25
"""A simple map is preferred if another would reduce the root mean square distance by less than this factor: noise alone
also favours a map, one that draws features to their mean."""

Map = Callable[[Tensor], Tensor]
"""From found activated features [N, K] to published ones [N, M]."""

Fit = Callable[[Tensor, Tensor], Map]


def unmixing(seen: Float64[Tensor, "P K"], wanted: Float64[Tensor, "P M"]) -> Map | None:
    """The map on which most of P Gaussians agree, from found activated features to published ones.

    Gaussians whose features were changed otherwise, up to about half, do not count. The map is a rotation or reflection
    with a scale and a shift if that suffices; it is affine if not, or if the numbers of channels differ. None if no map
    is needed: most features are as published, or no such map brings them much nearer. P = 0 is not allowed.
    """
    if seen.shape == wanted.shape and float((seen - wanted).norm(dim=1).median()) <= AS_PUBLISHED:
        return None
    affine = _most_agree_on(_affine, seen, wanted, _affine(seen, wanted))
    if seen.shape != wanted.shape:
        return affine
    turned = _most_agree_on(_turned, seen, wanted, affine)
    chosen = _simplest((_as_found, turned, affine), seen, wanted)
    return chosen if chosen is not _as_found else None


def _simplest(maps: Sequence[Map], seen: Float64[Tensor, "P M"], wanted: Float64[Tensor, "P M"]) -> Map:
    """The first map that reproduces most published features, or else the first that is about as near as the best."""
    distances = [(each(seen) - wanted).norm(dim=1) for each in maps]
    typical = [float(each.median()) for each in distances]
    overall = [float(each.square().mean().sqrt()) for each in distances]
    exact = [each for each, distance in zip(maps, typical, strict=True) if distance <= AS_PUBLISHED]
    near = [each for each, distance in zip(maps, overall, strict=True) if distance <= NO_NEARER * min(overall)]
    return (exact or near)[0]


def _as_found(features: Tensor) -> Tensor:
    return features


def _most_agree_on(fit: Fit, seen: Float64[Tensor, "P K"], wanted: Float64[Tensor, "P M"], start: Map) -> Map:
    """Fit a map by least trimmed squares (Rousseeuw 1984).

    It is fitted repeatedly to the half of the pairs that fits best, beginning with `start`, and finally to all pairs
    that fit about as well.
    """
    found = start
    for _ in range(CONCENTRATIONS):
        distances = (found(seen) - wanted).norm(dim=1)
        kept = distances <= distances.median()
        found = fit(seen[kept], wanted[kept])
    distances = (found(seen) - wanted).norm(dim=1)
    kept = distances <= SPREADS * distances.median().clamp_min(AS_PUBLISHED)
    return fit(seen[kept], wanted[kept])


def _affine(seen: Float64[Tensor, "P K"], wanted: Float64[Tensor, "P M"]) -> Map:
    """Fit an affine map by least squares."""
    start, end = seen.mean(dim=0), wanted.mean(dim=0)
    centred = seen - start
    inverse = torch.linalg.pinv(centred.T @ centred, rtol=SMALLEST_VARIANCE, hermitian=True)
    matrix = inverse @ (centred.T @ (wanted - end))
    return lambda features: (features - start) @ matrix + end


def _turned(seen: Float64[Tensor, "P M"], wanted: Float64[Tensor, "P M"]) -> Map:
    """Fit a rotation or reflection with a shift and a scale.

    Least squares, but for the scale, which is the ratio of the spreads: for noisy features, the least-squares scale
    would draw mapped features together.
    """
    start, end = seen.mean(dim=0), wanted.mean(dim=0)
    left, _, right = torch.linalg.svd((seen - start).T @ (wanted - end))
    scale = (wanted - end).norm() / (seen - start).norm().clamp_min(AS_PUBLISHED)
    matrix = scale * left @ right
    return lambda features: (features - start) @ matrix + end
