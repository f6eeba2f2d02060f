"""Identification: which found Gaussian is which published one, by position, shape and further attributes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from stages.scene.gaussians import Gaussians
from stages.scene.registration import Registration, register, register_scattered
from stages.scene.shape_pairs import ALIKE, typical_distance
from stages.scene.similarity import Similarity

MISSING = -1
"""The row of a published Gaussian that was not found."""

RESIDUALS = 3.0
"""Values are alike within this many median residuals of known pairs, to tolerate what was done to all Gaussians."""

ROUNDING = 1e-6
"""Rounding error in single precision, relative to the spread of a kind's values."""

CANDIDATES = 4
"""Found Gaussians considered for each published one: the nearest by position, by shape, and by all kinds together."""

SURE = 0.5
"""A match is final if it is at most this different: a sum over kinds of squared distances, each capped at 1."""

SAMPLED, PAIRED = 2000, 16
"""Published Gaussians sampled to estimate residuals, and found ones with which one kind of values pairs each."""

Rows = Int[np.ndarray, " P"]
"""Row numbers of pairs."""

Kind = tuple[Float[np.ndarray, "F D"], Float[np.ndarray, "N D"]]
"""Values of one kind, of the found and of the published Gaussians."""


def identified(found: Gaussians, published: Gaussians, seed: int, others: Sequence[Kind] = ()) -> Int[np.ndarray, " N"]:
    """For each published Gaussian, the row of the found one that it is, or `MISSING`; no row appears twice.

    Found Gaussians may be moved as a whole (see `register`, which takes `seed`), missing, doubled, added or reordered,
    and each may be changed slightly, or shifted to anywhere (`register_scattered`). Positions, sizes, opacities and
    `others` are compared. A candidate must be alike in more than half of these kinds of values; of several, the one
    with the smallest Σ log(1 + d²) over kinds is chosen. A thief who shifts every Gaussian slightly leaves the shapes
    intact, and one who puts decoys in their places cannot give these all attributes of the originals without changing
    the cover. All values must be finite; either side may be empty.
    """
    rows = np.full(len(published), MISSING, dtype=np.int64)
    registration = register(found, published, seed) or register_scattered(found, published, seed)
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
    """Positions and sorted log scales with the motion undone, and opacity logits."""
    yield motion.inverse().points(_values(found, "means")), _values(published, "means")
    yield _sizes(found) - np.log(motion.scale), _sizes(published)
    yield _values(found, "logit_opacities")[:, None], _values(published, "logit_opacities")[:, None]


def _units(kinds: Sequence[Kind], registration: Registration) -> list[float]:
    """For each kind, the distance within which values are alike: a fraction of that of neighbours, or as pairs show.

    Known pairs are the registration's, and those nearest by another kind. Of a published Gaussian's partners only the
    nearest counts, and of all pairings the one with the smallest residual: if decoys occupy the positions, pairs by
    position say nothing of the other kinds.
    """
    pairings: list[tuple[int | None, Rows, Rows]] = [(None, registration.found, registration.published)]
    for number, (own, known) in enumerate(kinds[1:], start=1):
        looked_at = np.arange(0, len(known), math.ceil(len(known) / SAMPLED))
        partners = _nearest_rows(own, known[looked_at], PAIRED)
        pairings.append((number, partners.ravel(), np.repeat(looked_at, partners.shape[1])))
    units = []
    for number, (own, known) in enumerate(kinds):
        residual = min(_residual(own, known, rows, partners) for by, rows, partners in pairings if by != number)
        unit = max(ALIKE * typical_distance(known), RESIDUALS * residual, ROUNDING * float(known.std()))
        units.append(unit or 1.0)
    return units


def _residual(own: Float[np.ndarray, "F D"], known: Float[np.ndarray, "N D"], found: Rows, published: Rows) -> float:
    """The median, over published Gaussians, of the distance to the nearest of their partners."""
    nearest = np.full(len(known), np.inf)
    np.minimum.at(nearest, published, np.linalg.norm(own[found] - known[published], axis=1))
    return float(np.median(nearest[np.isfinite(nearest)]))


def _nearest(kinds: Sequence[Kind], rows: Int[np.ndarray, " K"]) -> Iterator[Int[np.ndarray, " K"]]:
    """The found rows nearest to each of these published ones, then the second nearest, and so on."""
    if len(rows):
        own, known = (np.concatenate(values, axis=1) for values in zip(*kinds, strict=True))
        yield from _nearest_rows(own, known[rows], CANDIDATES).T


def _nearest_rows(own: Float[np.ndarray, "F D"], wanted: Float[np.ndarray, "K D"], most: int) -> Int[np.ndarray, "K C"]:
    """For each wanted value, the rows of the `most` nearest of `own`, or of all if there are fewer, nearest first.

    No more than these of each value go into the tree. It cannot part equal ones: whoever gives most found Gaussians one
    size and opacity would have each published one compared with all of them.
    """
    rows = _few_of_each(own, most)
    _, nearest = cKDTree(own[rows]).query(wanted, k=range(1, min(most, len(rows)) + 1))
    return rows[nearest]


def _few_of_each(values: Float[np.ndarray, "F D"], most: int) -> Int[np.ndarray, " R"]:
    """The rows, in order, of the first `most` of equal values."""
    order = np.lexsort(values.T)
    number = np.arange(len(values))
    is_new = np.ones(len(values), dtype=bool)
    is_new[1:] = (values[order[1:]] != values[order[:-1]]).any(axis=1)
    first = np.maximum.accumulate(np.where(is_new, number, 0))
    return np.sort(order[number - first < most])


def _each_once(rows: Int[np.ndarray, " N"], costs: Float[np.ndarray, " N"]) -> Int[np.ndarray, " N"]:
    """A found row claimed by several published ones goes to the one of least cost; the others become `MISSING`."""
    order = np.lexsort([costs, rows])
    again = np.zeros(len(rows), dtype=bool)
    again[order[1:]] = rows[order[1:]] == rows[order[:-1]]
    return np.where(again, MISSING, rows)


def _sizes(gaussians: Gaussians) -> Float[np.ndarray, "N 3"]:
    return np.sort(_values(gaussians, "log_scales"), axis=1)


def _values(gaussians: Gaussians, name: str) -> Float[np.ndarray, "N ..."]:
    return gaussians[name].detach().cpu().double().numpy()
