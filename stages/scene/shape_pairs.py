"""Gaussians paired by what no motion changes, and which pairs agree on one motion: RANSAC (Fischler, Bolles 1981)."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from stages.scene.gaussians import Gaussians
from stages.scene.similarity import Similarity, fit_similarity

ALIKE = 0.1
"""Of the distance at which published Gaussians typically have the next one, of a kind of values: what is so near to one
is alike. By chance one in a thousand is, of three values, and of four one in ten thousand."""

SAMPLED = 6000
"""Of the found Gaussians that partners are looked for."""

TRIPLES = 20_000
"""Drawn from the pairs: with one pair in ten right, twenty of them are right."""

TRIED = 200
"""Of the triples whose sides are in one proportion."""

REACH = 0.03
"""Of the scene's radius, in which half of the Gaussians are: pairs that a motion carries so near agree with it."""

SHORTEST = 0.3
"""Of the radius: the sides of triples; shorter ones tell too little of a turn."""

AGREEING = 0.1
"""Of the pairs must agree, if they are to be believed. Of two scenes that have nothing to do with each other, one in a
hundred does, with the motion that suits them best."""

FEWEST = 10
"""Pairs that must agree at least."""

TIGHTENINGS = 3
SPREADS = 4.0
"""Medians of the distances that pairs may be away from a motion that they agree on."""

ROUNDING = 1e-4
"""Of the reach: so far apart are pairs that agree, at most, by the rounding of what is stored."""


def pairs_by_shape(
    found: Gaussians, published: Gaussians, any_scale: bool, seed: int
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " P"], Bool[np.ndarray, " P"]]:
    """Rows of found and of published Gaussians that are nearest to each other in their sizes and opacities, and which
    of these are `ALIKE`.

    Sizes are the three logarithmic scales, sorted, as they are stored, or the proportions alone of `any_scale`;
    opacities are logits. Many pairs may be wrong. At most `SAMPLED` found Gaussians are looked at, drawn by `seed`.
    Neither may be without Gaussians.
    """
    shapes, known = _shapes(found, any_scale), _shapes(published, any_scale)
    spread = known.std(axis=0)
    spread[spread == 0] = 1.0
    shapes, known = shapes / spread, known / spread
    chosen = np.random.default_rng(seed).permutation(len(shapes))[:SAMPLED]
    apart, partners = cKDTree(known).query(shapes[chosen])
    _, back = cKDTree(shapes).query(known[partners])
    mutual, alike = back == chosen, apart <= ALIKE * typical_distance(known)
    return chosen[mutual], partners[mutual], alike[mutual]


def typical_distance(values: Float[np.ndarray, "N D"]) -> float:
    """The median distance to the next other one, of at most `SAMPLED` of them; 0 for a lone one."""
    if len(values) < 2:
        return 0.0
    distances, _ = cKDTree(values).query(values[:: math.ceil(len(values) / SAMPLED)], k=2)
    return float(np.median(distances[:, 1]))


def agreeing(
    source: Float[np.ndarray, "P 3"], target: Float[np.ndarray, "P 3"], seed: int
) -> Bool[np.ndarray, " P"] | None:
    """Which pairs agree on one similarity from sources to targets; None where too few do to be believed.

    The motion that misses them least, of what three pairs ask for, is fitted again to all that it carries to within
    `REACH`, and then to those that are no farther from it than most: what exact pairs agree on comes out exact. A miss
    counts for no more than `REACH`. Pairs at one place tell nothing.
    """
    if len(source) < FEWEST:
        return None
    reach = REACH * float(np.median(np.linalg.norm(source - np.median(source, axis=0), axis=1)))
    motions = [Similarity.identity(), *_tried(source, target, reach, np.random.default_rng(seed))]
    misses = [np.minimum(_distances(motion, source, target), reach).sum() for motion in motions]
    motion = motions[int(np.argmin(misses))]
    needed = max(FEWEST, AGREEING * len(source))
    for _ in range(TIGHTENINGS):
        distances = _distances(motion, source, target)
        within = distances <= reach
        if np.count_nonzero(within) < needed:
            return None
        typical = float(np.median(distances[within]))
        reach = min(reach, max(SPREADS * typical, ROUNDING * reach))
        within = distances <= reach
        try:
            motion = fit_similarity(source[within], target[within])
        except ValueError:  # all at one place
            return None
    return within


def _shapes(gaussians: Gaussians, any_scale: bool) -> Float[np.ndarray, "N D"]:
    log_scales = np.sort(gaussians["log_scales"].detach().double().numpy(), axis=1)
    sizes = np.diff(log_scales, axis=1) if any_scale else log_scales
    return np.concatenate([sizes, gaussians["logit_opacities"].detach().double().numpy()[:, None]], axis=1)


def _tried(
    source: Float[np.ndarray, "P 3"], target: Float[np.ndarray, "P 3"], reach: float, generator: np.random.Generator
) -> Iterator[Similarity]:
    """What triples of pairs ask for whose sides are long enough, and in one proportion to within what is in reach."""
    triples = generator.integers(len(source), size=(TRIPLES, 3))
    sides, moved = (
        np.linalg.norm(points[triples] - points[np.roll(triples, 1, axis=1)], axis=2) for points in (source, target)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        proportions = np.log(moved / sides)
        off = np.abs(proportions - proportions.mean(axis=1, keepdims=True))
        good = ((sides >= SHORTEST / REACH * reach) & (off <= 2 * reach / sides)).all(axis=1)
    for triple in triples[good][:TRIED]:
        yield fit_similarity(source[triple], target[triple])


def _distances(
    motion: Similarity, source: Float[np.ndarray, "P 3"], target: Float[np.ndarray, "P 3"]
) -> Float[np.ndarray, " P"]:
    """How far pairs are from agreeing, in units of the source world."""
    return np.linalg.norm(motion.points(source) - target, axis=1) / motion.scale
