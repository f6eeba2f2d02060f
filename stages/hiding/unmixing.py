"""Unmixing: the map that carries features, turned, permuted or thinned out, back to those that were published."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float64
from torch import Tensor

CONCENTRATIONS = 5
SPREADS = 4.0
"""Medians of the distances at which a pair may be from a map that it is to count for."""

SMALLEST_VARIANCE = 1e-12
"""Relative to the largest: combinations of channels that differ less than this tell nothing."""

AS_PUBLISHED = 1e-3
"""Of features: so near to what was published, they are what was published."""

NO_NEARER = 1.25
"""A simple map will do where another would bring features nearer by less than this factor, root mean square: noise,
too, asks for a map, which draws features to their mean."""

Map = Callable[[Tensor], Tensor]
"""From activated features [N, K] to those [N, M] as they were published."""

Fit = Callable[[Tensor, Tensor], Map]


def unmixing(seen: Float64[Tensor, "P K"], wanted: Float64[Tensor, "P M"]) -> Map | None:
    """The map on which most of P Gaussians agree, from their activated features as they were found to the published.

    Those whose features were changed otherwise, up to about half, do not count. The map is a turn, with a scale and a
    shift, if that will do, and affine if not, or if the numbers of channels differ. None if nothing is to be mapped:
    most features are as they were published, or none of these maps brings them much nearer. P = 0 is not allowed.
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
    """The first that brings most features to what was published; or else the first than which none brings all of them
    much nearer."""
    distances = [(each(seen) - wanted).norm(dim=1) for each in maps]
    typical = [float(each.median()) for each in distances]
    overall = [float(each.square().mean().sqrt()) for each in distances]
    exact = [each for each, distance in zip(maps, typical, strict=True) if distance <= AS_PUBLISHED]
    near = [each for each, distance in zip(maps, overall, strict=True) if distance <= NO_NEARER * min(overall)]
    return (exact or near)[0]


def _as_found(features: Tensor) -> Tensor:
    return features


def _most_agree_on(fit: Fit, seen: Float64[Tensor, "P K"], wanted: Float64[Tensor, "P M"], start: Map) -> Map:
    """A map by trimmed squares (Rousseeuw 1984): fitted to the half of the pairs that it suits best, `start` at first,
    and in the end to all that it suits about as well."""
    found = start
    for _ in range(CONCENTRATIONS):
        distances = (found(seen) - wanted).norm(dim=1)
        kept = distances <= distances.median()
        found = fit(seen[kept], wanted[kept])
    distances = (found(seen) - wanted).norm(dim=1)
    kept = distances <= SPREADS * distances.median().clamp_min(AS_PUBLISHED)
    return fit(seen[kept], wanted[kept])


def _affine(seen: Float64[Tensor, "P K"], wanted: Float64[Tensor, "P M"]) -> Map:
    """By least squares."""
    start, end = seen.mean(dim=0), wanted.mean(dim=0)
    centred = seen - start
    inverse = torch.linalg.pinv(centred.T @ centred, rtol=SMALLEST_VARIANCE, hermitian=True)
    matrix = inverse @ (centred.T @ (wanted - end))
    return lambda features: (features - start) @ matrix + end


def _turned(seen: Float64[Tensor, "P M"], wanted: Float64[Tensor, "P M"]) -> Map:
    """Turned, mirrored and scaled, by least squares but for the scale, which is that of the spreads: of noisy features,
    least squares would draw the mapped ones together."""
    start, end = seen.mean(dim=0), wanted.mean(dim=0)
    left, _, right = torch.linalg.svd((seen - start).T @ (wanted - end))
    scale = (wanted - end).norm() / (seen - start).norm().clamp_min(AS_PUBLISHED)
    matrix = scale * left @ right
    return lambda features: (features - start) @ matrix + end
