"""Which pairs of photos to match, with or without known poses."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Literal

import numpy as np
from jaxtyping import Float64

Matching = Literal["auto", "exhaustive", "sequential"]
Pair = tuple[int, int]

EXHAUSTIVE_UP_TO = 30  # photos; beyond, all pairs take long, and most are futile if the order of taking is known
RESCUE_UP_TO = 120  # photos; up to this many, all pairs are matched if those of a sequence place too few
OVERLAP = 10  # neighbours on either side that a photo of a sequence is matched with
KEYFRAME_EVERY = 10  # keyframes of a sequence are all matched with each other: a walk may return to a place
NEAREST = 20  # photos that each is matched with if poses are known
BLOCK = 8  # photos; pairs are grouped by blocks, whose descriptors stay in memory
BATCH = 64  # pairs that are matched at once, at least


def choose_pairs(
    matching: Matching, order: list[int], ordered: bool, poses: Float64[np.ndarray, "V 4 4"] | None = None
) -> tuple[set[Pair], set[Pair]]:
    """The pairs to match, and those to match as well if the first place too few photos.

    For more than `EXHAUSTIVE_UP_TO` photos, `auto` takes the pairs that `poses` (world to camera), if known, place near
    each other. Without poses it treats photos in a known order as a sequence, which may be wrong: names can be numbered
    in any order. `order` lists positions of photos in the order of the numbers in their names.
    """
    everything = exhaustive_pairs(len(order))
    if matching == "auto" and poses is not None and len(order) > EXHAUSTIVE_UP_TO:
        return posed_pairs(poses), set()
    if matching == "exhaustive" or (matching == "auto" and not (ordered and len(order) > EXHAUSTIVE_UP_TO)):
        return everything, set()
    near = sequential_pairs(order)
    rescued = matching == "auto" and len(order) <= RESCUE_UP_TO
    return near, everything - near if rescued else set()


def exhaustive_pairs(photos: int) -> set[Pair]:
    """All pairs, the smaller position first."""
    return set(combinations(range(photos), 2))


def sequential_pairs(order: list[int]) -> set[Pair]:
    """Pairs of a closed sequence of photos: neighbours, photos at distances of powers of two, and all keyframes.

    `order` lists positions of photos in the order of taking. The smaller position stands first in each pair.
    """
    count = len(order)
    steps = [*range(1, OVERLAP + 1), *(2**power for power in range(4, count.bit_length()))]
    near = ((order[at], order[(at + step) % count]) for at in range(count) for step in steps)
    far = combinations(order[::KEYFRAME_EVERY], 2)
    return {(min(pair), max(pair)) for pair in (*near, *far) if pair[0] != pair[1]}


def posed_pairs(world_to_camera: Float64[np.ndarray, "V 4 4"]) -> set[Pair]:
    """Each of V > `NEAREST` photos, paired with the `NEAREST` of most similar camera position and viewing direction.

    An angle of one radian weighs as much as the median distance of the cameras from their middle. That suits cameras
    that all look inwards, as well as those that look outwards from one place.
    """
    rotations, translations = world_to_camera[:, :3, :3], world_to_camera[:, :3, 3]
    centres, directions = -np.einsum("vij,vi->vj", rotations, translations), rotations[:, 2]
    size = np.median(np.linalg.norm(centres - np.median(centres, axis=0), axis=1)) or 1.0
    pairs: set[Pair] = set()
    for row, (centre, direction) in enumerate(zip(centres, directions, strict=True)):
        apart = np.linalg.norm(centres - centre, axis=1) / size + np.arccos(np.clip(directions @ direction, -1, 1))
        apart[row] = np.inf
        pairs |= {(min(row, other), max(row, other)) for other in np.argsort(apart, kind="stable")[:NEAREST].tolist()}
    return pairs


def in_batches(pairs: set[Pair]) -> Iterator[list[Pair]]:
    """The pairs in batches of neighbouring blocks of photos, each of `BATCH` pairs or more, but for the last."""
    batch: list[Pair] = []
    block = None
    for pair in sorted(pairs, key=lambda pair: (pair[0] // BLOCK, pair[1] // BLOCK, pair)):
        if (pair[0] // BLOCK, pair[1] // BLOCK) != block and len(batch) >= BATCH:
            yield batch
            batch = []
        block = (pair[0] // BLOCK, pair[1] // BLOCK)
        batch.append(pair)
    if batch:
        yield batch
