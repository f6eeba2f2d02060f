"""Pairs Gaussians by what no motion changes, and finds the pairs that agree on one: RANSAC (Fischler, Bolles 1981)."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from stages.scene.gaussians import Gaussians
from stages.scene.similarity import Similarity, fit_similarity

ALIKE = 0.1
"""Fraction of the typical distance between neighbouring published values of a kind: values this close are alike. By
chance one in a thousand values of three numbers is, and one in ten thousand of four. If more were found than published,
the distance shrinks to keep that chance the same."""

SAMPLED = 6000
"""Gaussians, at most, for which partners are sought."""

TRIPLES = 20_000
"""Drawn from the pairs; if one pair in ten is right, twenty triples are."""

TRIED = 200
"""Triples, at most, of those whose sides all scale alike."""

REACH = 0.03
"""Fraction of the scene's radius (half of the Gaussians are within it): pairs that a motion brings this close agree."""

SHORTEST = 0.3
"""Shortest side of a triple, as a fraction of the radius; shorter ones say too little about the rotation."""

AGREEING = 0.1
"""Fraction of the pairs that must agree to be believed. Of unrelated scenes, one pair in a hundred agrees with the
motion that suits them best."""

FEWEST = 10
"""Smallest number of pairs that must agree."""

TIGHTENINGS = 3
SPREADS = 4.0
"""How far pairs may be from a motion that they agree on, in medians of their distances."""

ROUNDING = 1e-4
"""Largest distance of agreeing pairs due to the rounding of stored values, as a fraction of the reach."""


def pairs_by_shape(
    found: Gaussians, published: Gaussians, seed: int, any_scale: bool = False, any_opacity: bool = False
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " P"], Bool[np.ndarray, " P"]]:
    """Rows of found and published Gaussians that are mutual nearest neighbours in shape, and which are `ALIKE`.

    Shapes are those of `shapes_of`. Many pairs may be wrong. Of the found or the published Gaussians, whichever are
    fewer, at most `SAMPLED` are used, drawn by `seed`: a few of a crowd would hardly be in a sample of it. Neither may
    be empty.
    """
    shapes, known = (shapes_of(each, any_scale, any_opacity) for each in (found, published))
    spread = known.std(axis=0)
    spread[spread == 0] = 1.0
    shapes, known = shapes / spread, known / spread
    near = ALIKE * typical_distance(known) * min(1.0, len(known) / len(shapes)) ** (1 / known.shape[1])
    fewer, more = (shapes, known) if len(shapes) <= len(known) else (known, shapes)
    chosen = np.random.default_rng(seed).permutation(len(fewer))[:SAMPLED]
    apart, partners = cKDTree(more).query(fewer[chosen])
    _, back = cKDTree(fewer).query(more[partners])
    mutual, alike = back == chosen, apart <= near
    rows = (chosen, partners) if fewer is shapes else (partners, chosen)
    return rows[0][mutual], rows[1][mutual], alike[mutual]


def shapes_of(gaussians: Gaussians, any_scale: bool = False, any_opacity: bool = False) -> Float[np.ndarray, "N D"]:
    """Sizes, the three log scales as stored, sorted, or only their two differences if `any_scale`; and opacity logits.

    No rotation or translation changes them. Without the last if `any_opacity`, for what was made more transparent.
    """
    log_scales = np.sort(gaussians["log_scales"].detach().double().numpy(), axis=1)
    sizes = np.diff(log_scales, axis=1) if any_scale else log_scales
    if any_opacity:
        return sizes
    return np.concatenate([sizes, gaussians["logit_opacities"].detach().double().numpy()[:, None]], axis=1)


def typical_distance(values: Float[np.ndarray, "N D"]) -> float:
    """The median distance to the nearest other value, over at most `SAMPLED` of them; 0 for fewer than two."""
    if len(values) < 2:
        return 0.0
    distances, _ = cKDTree(values).query(values[:: math.ceil(len(values) / SAMPLED)], k=2)
    return float(np.median(distances[:, 1]))


def agreeing(
    source: Float[np.ndarray, "P 3"], target: Float[np.ndarray, "P 3"], seed: int
) -> Bool[np.ndarray, " P"] | None:
    """Which pairs agree on one similarity from source to target; None if too few do to be believed.

    Of the identity and the similarities fitted to three pairs each, the one with the smallest sum of distances, each
    capped at `REACH`, is taken. It is fitted again to all pairs within `REACH`, then to those no farther off than most,
    so that exact pairs give an exact result. Coincident pairs determine nothing.
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


def _tried(
    source: Float[np.ndarray, "P 3"], target: Float[np.ndarray, "P 3"], reach: float, generator: np.random.Generator
) -> Iterator[Similarity]:
    """Similarities fitted to triples of pairs whose sides are long enough, and all scale alike up to the reach."""
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
    """Distances of the pairs under a motion, in units of the source world."""
    return np.linalg.norm(motion.points(source) - target, axis=1) / motion.scale
