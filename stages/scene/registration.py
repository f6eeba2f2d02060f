"""Registration: where Gaussians that were found stand beside those that were published, without being told.

Nothing of the found scene is trusted but what is there: Gaussians may be missing, doubled, added, moved as a whole, or
each a little, and stand in any order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from stages.scene.gaussians import Gaussians
from stages.scene.shape_pairs import FEWEST, SAMPLED, agreeing, pairs_by_shape
from stages.scene.similarity import Similarity, fit_similarity

NEAR = 0.1
"""Of the distance at which published Gaussians typically have their next neighbour: what lies so near to one of them is
that one. Of a scene that has nothing to do with it, one in a thousand lies so near to one by chance. Of more found than
published ones, it is nearer by as much as leaves chance the same."""

ENOUGH = 0.25
"""Of the found or of the published Gaussians, whichever are fewer: if so many published ones have a partner at their
place, places tell which is which. So a fragment is told, and what others were added to, however many: a thief would
have to leave out three quarters of what he stole, or shift each. Published ones are counted, each once, not found ones:
all that is heaped up at one place would do. Two trainings from the same photos, of thousands of iterations, had one in
500 to one in 20 in common, once one in 5; of 40 iterations, which hardly left the points that they began with, 7 in 10.
"""

ROUNDS = 20
"""Of iterated closest points at most; a few are enough where the start is good."""

BY_CHANCE = 50.0
"""Over the number of pairs: by what share squared distances may fall, in the mean, if a similarity is fitted to where
nothing moved, or was only turned and shifted. Its seven numbers take 7/3 on average."""

ROUNDING = 1e-6
"""Relative to coordinates: of motions in single precision."""


@dataclass(frozen=True)
class Registration:
    """`motion` carries the published world into the found one: exactly the identity where nothing tells of a motion.

    `found` and `published` are the rows of P pairs, each one Gaussian as it was found and as it was published; found
    ones may share a partner. `matched` is the share of the found Gaussians that lie where a published one does,
    `found_again` that of the published ones at which a found one lies, or the share that has the shape of one, where
    places tell less (as of those that were looked at). `is_certain` where either is enough (`ENOUGH`) to tell; the
    pairs are by shape where places do not (`by_place`).
    """

    motion: Similarity
    found: Int[np.ndarray, " P"]
    published: Int[np.ndarray, " P"]
    matched: float
    found_again: float
    is_certain: bool
    by_place: bool


def register(found: Gaussians, published: Gaussians, seed: int) -> Registration | None:
    """Rotation, translation and uniform scale that carry published Gaussians to where they were found, and pairs.

    If the found ones lie where published ones do, there is next to no motion. Else Gaussians are paired by what none
    changes, their sizes and opacities, and motions are tried that three pairs at a time ask for; the one that most
    pairs agree on is taken. Closest points make it exact. Where single Gaussians were shifted by so much that places
    tell nothing, the pairs are those by shape that agree; if enough of them have the very shape of a published one,
    they are known for certain all the same. Simple motions are preferred: none at all, then one without scale, unless
    another is closer than chance can explain.

    None where no motion is agreed on, and where either has no Gaussians; it takes ten pairs at least.
    `seed`: of the Gaussians and triples that are tried. All values are to be finite.
    """
    if not len(found) or not len(published):
        return None
    points, places = _means(found), _Places(_means(published))
    unmoved = places.partners(points, Similarity.identity())
    if unmoved.is_certain:
        return _by_closest_points(points, places, unmoved)
    for any_scale in (False, True):
        by_shape = _by_shape(found, published, any_scale, seed)
        if by_shape is not None:
            by_place = places.partners(points, by_shape.motion)
            if by_place.is_certain:
                return _by_closest_points(points, places, by_place)
            return replace(
                by_shape,
                matched=max(by_place.matched, by_shape.matched),
                found_again=max(by_place.found_again, by_shape.found_again),
            )
    return None


class _Places:
    """Where published Gaussians are, and how near to one of them something must lie to be it."""

    def __init__(self, points: Float[np.ndarray, "N 3"]):
        self.points, self.tree = points, cKDTree(points)
        distances, _ = self.tree.query(points, k=2)
        self.near = NEAR * float(np.median(distances[:, 1])) if len(points) > 1 else 0.0

    def partners(self, points: Float[np.ndarray, "F 3"], motion: Similarity) -> Registration:
        """The pairs after a motion is undone: each found Gaussian with the nearest published one, if that is near."""
        count, known = len(points), len(self.points)
        near = self.near * min(1.0, known / count) ** (1 / 3)
        distances, rows = self.tree.query(motion.inverse().points(points), distance_upper_bound=2 * near + 1e-12)
        [matched] = np.nonzero(distances <= near)
        again = len(np.unique(rows[matched]))
        is_certain = again >= max(FEWEST, ENOUGH * min(count, known))
        return Registration(
            motion, matched, rows[matched], len(matched) / count, again / known, is_certain, by_place=is_certain
        )


def _by_closest_points(points: Float[np.ndarray, "F 3"], places: _Places, start: Registration) -> Registration:
    current = start
    for _ in range(ROUNDS):
        motion = _simplest(places.points[current.published], points[current.found], current.motion)
        if _same(motion, current.motion):
            break
        current = places.partners(points, motion)
    return current


def _by_shape(found: Gaussians, published: Gaussians, any_scale: bool, seed: int) -> Registration | None:
    rows, partners, alike = pairs_by_shape(found, published, any_scale, seed)
    source, target = _means(published)[partners], _means(found)[rows]
    pairs = agreeing(source, target, seed)
    if pairs is None:
        return None
    motion = _simplest(source[pairs], target[pairs], Similarity.identity())
    matched = float(np.count_nonzero(alike & pairs)) / min(len(found), SAMPLED)
    known, needed = matched * len(found), max(FEWEST, ENOUGH * min(len(found), len(published)))
    found_again = min(1.0, known / len(published))
    return Registration(motion, rows[pairs], partners[pairs], matched, found_again, known >= needed, by_place=False)


def _simplest(source: Float[np.ndarray, "P 3"], target: Float[np.ndarray, "P 3"], without: Similarity) -> Similarity:
    """No motion, or one without scale, or with: the first that is as close as the last, but for chance and rounding.

    `without` where the pairs are too few, or all at one place, and tell nothing.
    """
    try:
        fitted = fit_similarity(source, target)
    except ValueError:
        return without
    shift = target.mean(axis=0) - fitted.rotation @ source.mean(axis=0)
    allowed = _error(fitted, source, target) * (1 + BY_CHANCE / len(source))
    allowed += ROUNDING**2 * float((target**2).sum(axis=1).mean())
    for simpler in (Similarity.identity(), Similarity(1.0, fitted.rotation, shift)):
        if _error(simpler, source, target) <= allowed:
            return simpler
    return fitted


def _same(motion: Similarity, other: Similarity) -> bool:
    turned = np.array_equal(motion.rotation, other.rotation)
    return turned and motion.scale == other.scale and np.array_equal(motion.translation, other.translation)


def _error(motion: Similarity, source: Float[np.ndarray, "P 3"], target: Float[np.ndarray, "P 3"]) -> float:
    """The mean squared distance."""
    return float(((motion.points(source) - target) ** 2).sum(axis=1).mean())


def _means(gaussians: Gaussians) -> Float[np.ndarray, "N 3"]:
    return gaussians.means.detach().double().numpy()
