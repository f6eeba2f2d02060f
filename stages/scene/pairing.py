"""Which photos are compared with which, whether or not it is known where they were taken."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Literal

import numpy as np
from jaxtyping import Float64

Matching = Literal["auto", "exhaustive", "sequential"]
Pair = tuple[int, int]

EXHAUSTIVE_UP_TO = 30  # photos; all pairs of more take long, and most are in vain where the order of taking is known
RESCUE_UP_TO = 120  # photos; up to so many, all pairs are compared after all where those of a sequence place too few
OVERLAP = 10  # neighbours on either side that a photo of a sequence is compared with
KEYFRAME_EVERY = 10  # in a sequence these are all compared with each other: a walk comes back to where it was
NEAREST = 20  # photos that each is compared with where poses say which they are
BLOCK = 8  # photos; pairs are grouped by blocks, whose descriptors stay in memory


def choose_pairs(
    matching: Matching, order: list[int], ordered: bool, poses: Float64[np.ndarray, "V 4 4"] | None = None
) -> tuple[set[Pair], set[Pair]]:
    """The pairs to compare, and those to compare as well where the first place too few photos.

    Of more than `EXHAUSTIVE_UP_TO` photos `auto` compares those that `poses` (world to camera), if they are known,
    place near each other. Without them it takes photos whose order is known for a sequence, and may be mistaken: names
    can be numbered in any order. `order` lists positions of photos in the order of their names' numbers.
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
    """Pairs of a closed sequence of photos: neighbours, then at distances of powers of two, and all keyframes.

    `order` lists positions of photos in the order of taking. The smaller position stands first in each pair.
    """
    count = len(order)
    steps = [*range(1, OVERLAP + 1), *(2**power for power in range(4, count.bit_length()))]
    near = ((order[at], order[(at + step) % count]) for at in range(count) for step in steps)
    far = combinations(order[::KEYFRAME_EVERY], 2)
    return {(min(pair), max(pair)) for pair in (*near, *far) if pair[0] != pair[1]}


def posed_pairs(world_to_camera: Float64[np.ndarray, "V 4 4"]) -> set[Pair]:
    """Each of V > `NEAREST` photos with the `NEAREST` whose cameras stood and looked most like its own.

    A radian between two directions of view counts as the median distance of the cameras from their middle: so it is
    where all look inwards, and where all stand in one place and look outwards.
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


def in_batches(pairs: set[Pair], at_least: int = 64) -> Iterator[list[Pair]]:
    """The pairs in batches of neighbouring blocks of photos, each but the last of `at_least` pairs or more."""
    batch: list[Pair] = []
    block = None
    for pair in sorted(pairs, key=lambda pair: (pair[0] // BLOCK, pair[1] // BLOCK, pair)):
        if (pair[0] // BLOCK, pair[1] // BLOCK) != block and len(batch) >= at_least:
            yield batch
            batch = []
        block = (pair[0] // BLOCK, pair[1] // BLOCK)
        batch.append(pair)
    if batch:
        yield batch
