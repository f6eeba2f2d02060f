"""Registration: how found Gaussians are placed relative to the published ones, without prior knowledge.

Nothing about the found scene is trusted but the Gaussians themselves: they may be missing, doubled, added, moved as a
whole or each a little, and in any order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from stages.scene.gaussians import Gaussians
from stages.scene.shape_pairs import ALIKE, FEWEST, SAMPLED, agreeing, pairs_by_shape, shapes_of, typical_distance
from stages.scene.similarity import Similarity, fit_similarity

NEAR = 0.1
"""Fraction of the typical distance between neighbouring published Gaussians: a found one this close to one of them is
taken for it. In an unrelated scene, one in a thousand is this close by chance. If more Gaussians were found than
published, the distance shrinks to keep that chance the same."""

ENOUGH = 0.25
"""Fraction of the found or the published Gaussians, whichever are fewer: if so many published ones have a partner at
their position, positions tell the motion. So a fragment is recognised, and a scene with any number of additions: a
thief would have to leave out three quarters of what he stole, or shift each. Published ones are counted, each once,
since found ones could all be heaped up at one place. Two trainings from the same photos, of thousands of iterations,
shared one in 500 to one in 20, once one in 5; of 40 iterations, which hardly left their initial points, 7 in 10."""

NEARLY_ALL, SHAPED = 0.8, 0.1
"""Positions alone do not tell whose it is: structure from motion gives all trainings from the same photos the same
initial points, which hardly move where many photos see them. Of a tenth of such a training, the smallest Gaussians, 0.5
lay at positions of another one, of a few fragments up to 0.65, of all after 40 iterations 0.7; none had a shape like
its partner's. So it also takes `NEARLY_ALL` at the position of a published one, or `SHAPED` of the pairs alike."""

ROUNDS = 20
"""Iterations of iterated closest points (ICP) at most; from a good start a few are enough."""

CHANGED: tuple[dict[str, bool], ...] = ({}, {"any_scale": True}, {"any_opacity": True})
"""What may have changed of all Gaussians beside their places: the attempts to find a motion by shapes, in order."""

BY_CHANCE = 50.0
"""Divided by the number of pairs, the fraction by which mean squared distances may fall when a similarity is fitted
although nothing moved, or was only rotated and translated. Its seven parameters account for 7/3 on average."""

ROUNDING = 1e-6
"""Rounding error of motions in single precision, relative to coordinates."""


@dataclass(frozen=True)
class Registration:
    """`motion` maps the published world into the found one; exactly the identity if nothing indicates a motion.

    `found` and `published` are the rows of P pairs of one Gaussian as found and as published; found ones may share a
    partner. `matched` is the fraction of the found Gaussians at the position of a published one, `found_again` that of
    the published ones with a found one at theirs; or, if larger, the fraction with the same shape, estimated from a
    sample. Pairs are by position if `by_place`, since positions reach `ENOUGH`, else by shape. `is_certain` if one was
    made from the other: if shapes reach `ENOUGH`, or positions do and `NEARLY_ALL` or `SHAPED` as well.
    """

    motion: Similarity
    found: Int[np.ndarray, " P"]
    published: Int[np.ndarray, " P"]
    matched: float
    found_again: float
    is_certain: bool
    by_place: bool


def register(found: Gaussians, published: Gaussians, seed: int) -> Registration | None:
    """The rotation, translation and uniform scale that carry published Gaussians to where they were found, and pairs.

    If the found ones lie at published positions, there is hardly any motion. Otherwise Gaussians are paired by what no
    motion changes, sizes and opacities, or by sizes alone if all were made more or less transparent. Of the motions
    fitted to three pairs each, the one that most pairs agree on is taken and refined by closest points (ICP). If single
    Gaussians were shifted too far for positions to tell, the pairs are those by shape that agree; they are certain if
    enough have exactly the shape of a published one. Simple motions are preferred, first none, then one without scale,
    unless another fits better than chance explains.

    None if no motion is agreed on, which takes at least ten pairs, or if either has no Gaussians. `seed` selects the
    Gaussians and triples that are tried. All values must be finite.
    """
    if not len(found) or not len(published):
        return None
    places = _Places(published)
    unmoved = places.partners(found, Similarity.identity())
    if unmoved.by_place:
        return _by_closest_points(found, places, unmoved)
    for changed in CHANGED:
        by_shape = _by_shape(found, published, seed, **changed)
        if by_shape is not None:
            by_place = places.partners(found, by_shape.motion)
            if by_place.by_place:
                return _by_closest_points(found, places, by_place)
            return replace(
                by_shape,
                matched=max(by_place.matched, by_shape.matched),
                found_again=max(by_place.found_again, by_shape.found_again),
            )
    return None


def register_scattered(found: Gaussians, published: Gaussians, seed: int) -> Registration | None:
    """The registration if each Gaussian was shifted by itself, too far for `register` to see a motion of the whole.

    Pairs are those with exactly the same sizes and opacity. If these are `ENOUGH` of the found or the published ones,
    whichever are fewer, it is certain that one was made from the other; else the answer is None, as it is if either has
    none. The motion is the simplest that fits the pairs, up to what their shifts leave open. `seed` as in `register`.
    """
    if not len(found) or not len(published):
        return None
    rows, partners, alike = pairs_by_shape(found, published, seed)
    if not _are_enough(found, published, alike):
        return None
    rows, partners = rows[alike], partners[alike]
    motion = _simplest(_means(published)[partners], _means(found)[rows], Similarity.identity())
    matched, found_again = _known_by_shape(found, published, alike)
    return Registration(motion, rows, partners, matched, found_again, is_certain=True, by_place=False)


class _Places:
    """Published Gaussians, and the distance within which a found one is taken for one of them."""

    def __init__(self, published: Gaussians):
        self.points, self.shapes = _means(published), shapes_of(published)
        self.tree = cKDTree(self.points)
        distances, _ = self.tree.query(self.points, k=2)
        self.near = NEAR * float(np.median(distances[:, 1])) if len(self.points) > 1 else 0.0
        self.spread = self.shapes.std(axis=0)
        self.spread[self.spread == 0] = 1.0
        self.alike = ALIKE * typical_distance(self.shapes / self.spread)

    def partners(self, found: Gaussians, motion: Similarity) -> Registration:
        """The pairs after undoing a motion: each found Gaussian with the nearest published one, if near enough."""
        points = _means(found)
        count, known = len(points), len(self.points)
        near = self.near * min(1.0, known / count) ** (1 / 3)
        distances, rows = self.tree.query(motion.inverse().points(points), distance_upper_bound=2 * near + 1e-12)
        [matched] = np.nonzero(distances <= near)
        partners = rows[matched]
        again, fewer = len(np.unique(partners)), min(count, known)
        by_place = again >= max(FEWEST, ENOUGH * fewer)
        is_certain = by_place and (again >= NEARLY_ALL * fewer or self._shaped(found, matched, partners, motion.scale))
        return Registration(motion, matched, partners, len(matched) / count, again / known, is_certain, by_place)

    def _shaped(
        self, found: Gaussians, matched: Int[np.ndarray, " P"], partners: Int[np.ndarray, " P"], scale: float
    ) -> bool:
        """Whether `SHAPED` of the published Gaussians that have partners have one of their own shape."""
        shapes = shapes_of(found)[matched]
        shapes[:, :-1] -= np.log(scale)
        alike = np.linalg.norm((shapes - self.shapes[partners]) / self.spread, axis=1) <= self.alike
        return len(np.unique(partners[alike])) >= SHAPED * len(np.unique(partners))


def _by_closest_points(found: Gaussians, places: _Places, start: Registration) -> Registration:
    current, points = start, _means(found)
    for _ in range(ROUNDS):
        motion = _simplest(places.points[current.published], points[current.found], current.motion)
        if _same(motion, current.motion):
            break
        current = places.partners(found, motion)
    return current


def _by_shape(
    found: Gaussians, published: Gaussians, seed: int, any_scale: bool = False, any_opacity: bool = False
) -> Registration | None:
    rows, partners, alike = pairs_by_shape(found, published, seed, any_scale, any_opacity)
    source, target = _means(published)[partners], _means(found)[rows]
    pairs = agreeing(source, target, seed)
    if pairs is None:
        return None
    motion = _simplest(source[pairs], target[pairs], Similarity.identity())
    matched, found_again = _known_by_shape(found, published, alike & pairs)
    is_certain = _are_enough(found, published, alike & pairs if any_scale or any_opacity else alike)
    return Registration(motion, rows[pairs], partners[pairs], matched, found_again, is_certain, by_place=False)


def _known_by_shape(found: Gaussians, published: Gaussians, alike: Bool[np.ndarray, " P"]) -> tuple[float, float]:
    """`matched` and `found_again`, from which pairs of a sample have exactly the same shape."""
    fewer = min(len(found), len(published))
    known = fewer * float(np.count_nonzero(alike)) / min(fewer, SAMPLED)
    return known / len(found), known / len(published)


def _are_enough(found: Gaussians, published: Gaussians, alike: Bool[np.ndarray, " P"]) -> bool:
    """Whether shapes reach `ENOUGH`, wherever their Gaussians lie: each may have been shifted by itself."""
    matched, _ = _known_by_shape(found, published, alike)
    return matched * len(found) >= max(FEWEST, ENOUGH * min(len(found), len(published)))


def _simplest(source: Float[np.ndarray, "P 3"], target: Float[np.ndarray, "P 3"], without: Similarity) -> Similarity:
    """No motion, one without scale, or one with: the first that fits as well as the last, up to chance and rounding.

    `without` if the pairs are too few or coincide, and determine nothing.
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
    """The mean squared distance of the pairs under a motion."""
    return float(((motion.points(source) - target) ** 2).sum(axis=1).mean())


def _means(gaussians: Gaussians) -> Float[np.ndarray, "N 3"]:
    return gaussians.means.detach().double().numpy()
