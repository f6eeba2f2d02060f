"""False alarms after distortions: a part of the pictures without a watermark is tried after them, as renders are."""

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
    """All of them, and of every `one_of` that are counted as other scenes one, drawn at random, distorted in every way.

    Those come right after it, and are counted in no sum. Where fewer than `one_of` are left, none of them may be drawn.
    Nothing is added where `one_of` is 0.
    """
    drawn = _one_of_every(one_of, np.random.default_rng(seed))
    generators = [np.random.default_rng(seed) for _ in DISTORTIONS]
    for negative, picture in negatives:
        yield negative, picture
        if one_of and negative.total == OTHER_SCENES and next(drawn):
            for distortion, generator in zip(DISTORTIONS, generators, strict=True):
                yield replace(negative, total=None, distortion=distortion), distortion.apply(picture, generator)


def most_distorted(count: int, one_of: int) -> int:
    """How many distorted pictures so many of other scenes lead to, at most."""
    return -(-count // one_of) * len(DISTORTIONS) if one_of else 0


def _one_of_every(count: int, generator: np.random.Generator) -> Iterator[bool]:
    """Without end: whether it is the one that is drawn of so many."""
    while True:
        drawn = int(generator.integers(count))
        yield from (place == drawn for place in range(count))
