from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stages.scene.pairing import (
    BATCH,
    Matching,
    choose_pairs,
    exhaustive_pairs,
    in_batches,
    posed_pairs,
    sequential_pairs,
)


@given(st.permutations(range(40)))
def test_a_sequence_compares_neighbours_both_ends_and_keyframes(order: list[int]) -> None:
    pairs = sequential_pairs(order)
    assert all(first < second for first, second in pairs)
    wanted = [*pairwise(order), (order[-1], order[0]), (order[0], order[16]), (order[0], order[20])]
    assert {(min(pair), max(pair)) for pair in wanted} <= pairs
    assert len(pairs) < len(exhaustive_pairs(40))


@pytest.mark.parametrize("count", [0, 1, 2, 3, 11])
def test_few_photos_are_all_compared(count: int) -> None:
    assert sequential_pairs(list(range(count))) == exhaustive_pairs(count)


@given(st.integers(0, 60))
def test_batches_hold_every_pair_once(photos: int) -> None:
    batches = list(in_batches(exhaustive_pairs(photos)))
    flat = [pair for batch in batches for pair in batch]
    assert sorted(flat) == sorted(exhaustive_pairs(photos))
    assert all(len(batch) >= BATCH for batch in batches[:-1])


@pytest.mark.parametrize("inwards", [True, False])
def test_photos_are_compared_with_those_that_stand_and_look_alike(inwards: bool) -> None:
    """A ring of 90 cameras that look inwards, or one camera that turns on the spot, in random order."""
    places = np.random.default_rng(0).permutation(90)
    angles = np.radians(4 * places)
    poses = np.tile(np.eye(4), (90, 1, 1))
    poses[:, 0, [0, 2]] = np.stack([np.cos(angles), -np.sin(angles)], axis=1)
    poses[:, 2, [0, 2]] = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    poses[:, 2, 3] = 5 if inwards else 0
    pairs = posed_pairs(poses)
    rolls = np.tile(np.eye(4), (90, 1, 1))
    rolls[:, :3, :3] = Rotation.from_rotvec(np.random.default_rng(1).uniform(0, 6, (90, 1)) * [0, 0, 1]).as_matrix()
    assert posed_pairs(rolls @ poses) == pairs, "however a camera is held"
    steps = Counter(min((places[a] - places[b]) % 90, (places[b] - places[a]) % 90) for a, b in pairs)
    assert steps == dict.fromkeys(range(1, 11), 90)
    assert all(first < second for first, second in pairs)


def test_poses_decide_what_is_compared_of_many_photos() -> None:
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, 0, 3] = range(40)
    assert choose_pairs("auto", list(range(40)), True, poses) == (posed_pairs(poses), set())
    assert choose_pairs("exhaustive", list(range(40)), True, poses)[0] == exhaustive_pairs(40)
    assert choose_pairs("auto", list(range(30)), True, poses[:30])[0] == exhaustive_pairs(30)
    assert (0, 39) not in posed_pairs(poses)


@pytest.mark.parametrize(
    ("matching", "photos", "ordered", "sequence", "rescued"),
    [
        ("auto", 30, True, False, False),
        ("auto", 31, True, True, True),
        ("auto", 31, False, False, False),
        ("auto", 120, True, True, True),
        ("auto", 121, True, True, False),
        ("sequential", 40, False, True, False),
        ("exhaustive", 40, True, False, False),
    ],
)
def test_what_is_compared(matching: Matching, photos: int, ordered: bool, sequence: bool, rescued: bool) -> None:
    order, everything = list(range(photos)), exhaustive_pairs(photos)
    pairs, in_need = choose_pairs(matching, order, ordered)
    assert pairs == (sequential_pairs(order) if sequence else everything)
    assert in_need == (everything - pairs if rescued else set())
