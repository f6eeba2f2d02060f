"""False positives after distortions: some pictures without a watermark are distorted as the renders are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from stages.analysis.watermark_trials import OTHER_SCENES, Negative
from stages.imaging.distortions import DISTORTIONS
from stages.imaging.pictures import Picture


def with_distorted(
    negatives: Iterable[tuple[Negative, Picture]], one_of: int, seed: int
) -> Iterator[tuple[Negative, Picture]]:
    """All negatives, and for one in `one_of` of those counted in `OTHER_SCENES` a copy after each distortion.

    It is drawn at random from each run of `one_of`, possibly none from an incomplete last run. The distorted copies
    follow it and have no `total`. If `one_of` is 0, nothing is added.
    """
    drawn = _one_of_every(one_of, np.random.default_rng(seed))
    generators = [np.random.default_rng(seed) for _ in DISTORTIONS]
    for negative, picture in negatives:
        yield negative, picture
        if one_of and negative.total == OTHER_SCENES and next(drawn):
            for distortion, generator in zip(DISTORTIONS, generators, strict=True):
                yield replace(negative, total=None, distortion=distortion), distortion.apply(picture, generator)


def most_distorted(count: int, one_of: int) -> int:
    """The largest number of distorted pictures that `count` pictures of other scenes can lead to."""
    return -(-count // one_of) * len(DISTORTIONS) if one_of else 0


def _one_of_every(count: int, generator: np.random.Generator) -> Iterator[bool]:
    """Endless flags: in each run of `count`, exactly one is True, at a random place."""
    while True:
        drawn = int(generator.integers(count))
        yield from (place == drawn for place in range(count))
