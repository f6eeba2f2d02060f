"""Identification: which found Gaussian each published one is, by its place, its shape, and what else is told of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from stages.scene.gaussians import Gaussians
from stages.scene.registration import Registration, register
from stages.scene.shape_pairs import ALIKE, typical_distance
from stages.scene.similarity import Similarity

MISSING = -1
"""For the row of a published Gaussian that was not found."""

RESIDUALS = 3.0
"""Medians of how far values of a kind are apart in pairs that are known: what was done to all of them is forgiven."""

ROUNDING = 1e-6
"""Of the spread of values of a kind: single precision."""

CANDIDATES = 4
"""Found Gaussians that are looked at for each published one, of the nearest by place, by shape, and by everything."""

SURE = 0.5
"""So unlike, as a sum over kinds of squares that are at most 1, may one be for none that is nearer to be sought."""

SAMPLED, PAIRED = 2000, 16
"""Published ones by which it is seen how far values are apart, and found ones that each is paired with by one kind."""

Rows = Int[np.ndarray, " P"]
"""Of pairs."""

Kind = tuple[Float[np.ndarray, "F D"], Float[np.ndarray, "N D"]]
"""Values of one kind, of the found Gaussians and of the published ones."""


def identified(found: Gaussians, published: Gaussians, seed: int, others: Sequence[Kind] = ()) -> Int[np.ndarray, " N"]:
    """For each published Gaussian the row of the found one that is it, or `MISSING`; no two are the same.

    Found ones may be moved as a whole (`register`, whose `seed` it is), missing, doubled, added, in any order, and each
    changed a little. Places, sizes, opacities and `others` are compared. One that is alike in more than half of these
    kinds of values may be taken, and of several the one whose values are nearest, Σ log(1 + d²) over kinds: a thief who
    shifts every Gaussian a little leaves their shapes, and who puts decoys in their places cannot give these all that
    they have, or the cover would change. All values are to be finite; either may have no Gaussians.
    """
    rows = np.full(len(published), MISSING, dtype=np.int64)
    registration = register(found, published, seed)
    if registration is None:
        return rows
    kinds = [*_geometry(found, published, registration.motion), *others]
    units = _units(kinds, registration)
    kinds = [(own / unit, known / unit) for (own, known), unit in zip(kinds, units, strict=True)]
    nearest, unlike = np.full(len(published), np.inf), np.full(len(published), np.inf)
    for compared in (kinds[:1], kinds[1:3], kinds):
        [unsure] = np.nonzero(unlike > SURE)
        for candidates in _nearest(compared, unsure):
            apart = np.stack([np.square(own[candidates] - known[unsure]).sum(axis=1) for own, known in kinds])
            different, far = np.minimum(1.0, apart).sum(axis=0), np.log1p(apart).sum(axis=0)
            better = (different < len(kinds) / 2) & (far < nearest[unsure])
            taken = unsure[better]
            rows[taken], nearest[taken], unlike[taken] = candidates[better], far[better], different[better]
    return _each_once(rows, nearest)


def _geometry(found: Gaussians, published: Gaussians, motion: Similarity) -> Iterator[Kind]:
    """Places before the motion, logarithmic sizes in ascending order, and logits of opacities."""
    yield motion.inverse().points(_values(found, "means")), _values(published, "means")
    yield _sizes(found) - np.log(motion.scale), _sizes(published)
    yield _values(found, "logit_opacities")[:, None], _values(published, "logit_opacities")[:, None]


def _units(kinds: Sequence[Kind], registration: Registration) -> list[float]:
    """Within which values of each kind are alike: as near as next ones are not, or as pairs that are known show.

    Known are the registration's, and those that are near by another kind. Of all with which a published one is paired
    the nearest counts, and of all ways to pair the one by which they are nearest: where decoys stand at the places,
    pairs by place know nothing of the rest.
    """
    pairings: list[tuple[int | None, Rows, Rows]] = [(None, registration.found, registration.published)]
    for number, (own, known) in enumerate(kinds[1:], start=1):
        looked_at = np.arange(0, len(known), math.ceil(len(known) / SAMPLED))
        _, partners = cKDTree(own).query(known[looked_at], k=range(1, min(PAIRED, len(own)) + 1))
        pairings.append((number, partners.ravel(), np.repeat(looked_at, partners.shape[1])))
    units = []
    for number, (own, known) in enumerate(kinds):
        residual = min(_residual(own, known, rows, partners) for by, rows, partners in pairings if by != number)
        unit = max(ALIKE * typical_distance(known), RESIDUALS * residual, ROUNDING * float(known.std()))
        units.append(unit or 1.0)
    return units


def _residual(own: Float[np.ndarray, "F D"], known: Float[np.ndarray, "N D"], found: Rows, published: Rows) -> float:
    """How far pairs are apart: the median over published ones, each with the nearest of its partners."""
    nearest = np.full(len(known), np.inf)
    np.minimum.at(nearest, published, np.linalg.norm(own[found] - known[published], axis=1))
    return float(np.median(nearest[np.isfinite(nearest)]))


def _nearest(kinds: Sequence[Kind], rows: Int[np.ndarray, " K"]) -> Iterator[Int[np.ndarray, " K"]]:
    """For these published ones the rows of found ones, the nearest of all and then the next."""
    if len(rows):
        own, known = (np.concatenate(values, axis=1) for values in zip(*kinds, strict=True))
        _, nearest = cKDTree(own).query(known[rows], k=range(1, min(CANDIDATES, len(own)) + 1))
        yield from nearest.T


def _each_once(rows: Int[np.ndarray, " N"], costs: Float[np.ndarray, " N"]) -> Int[np.ndarray, " N"]:
    """Of several published ones that are the same found one, the one that is nearest has it."""
    order = np.lexsort([costs, rows])
    again = np.zeros(len(rows), dtype=bool)
    again[order[1:]] = rows[order[1:]] == rows[order[:-1]]
    return np.where(again, MISSING, rows)


def _sizes(gaussians: Gaussians) -> Float[np.ndarray, "N 3"]:
    return np.sort(_values(gaussians, "log_scales"), axis=1)


def _values(gaussians: Gaussians, name: str) -> Float[np.ndarray, "N ..."]:
    return gaussians[name].detach().cpu().double().numpy()
