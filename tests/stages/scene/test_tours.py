"""Tours are short: they go round a ring, and exchanging two of their steps does not shorten them."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest

from stages.scene.tours import by_way_of_others, longest_step_last, shortest_tour, step_lengths


def length(points: np.ndarray, order: np.ndarray) -> float:
    return float(step_lengths(points[np.append(order, order[:1])]).sum())


def test_round_a_ring_in_whatever_order_it_comes() -> None:
    angles = np.random.default_rng(0).permutation(24) * 2 * np.pi / 24
    order = shortest_tour(np.stack([np.cos(angles), np.sin(angles)], axis=1))
    turns = np.diff(np.unwrap(angles[order])) / (2 * np.pi / 24)
    assert np.allclose(np.abs(turns), 1)
    assert len(set(np.sign(turns))) == 1


@pytest.mark.parametrize("seed", range(5))
def test_nearly_the_shortest_of_all(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(size=(7, 2))
    least = min(length(points, np.array((0, *rest))) for rest in permutations(range(1, 7)))
    assert length(points, shortest_tour(points)) <= 1.05 * least


@pytest.mark.parametrize("seed", range(3))
def test_no_exchange_of_two_steps_shortens_it(seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(30, 3))
    order = shortest_tour(points)
    for first, last in combinations(range(len(order)), 2):
        other = np.concatenate([order[: first + 1], order[first + 1 : last + 1][::-1], order[last + 1 :]])
        assert length(points, other) >= length(points, order) - 1e-9


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_points(count: int) -> None:
    points = np.random.default_rng(0).normal(size=(count, 3))
    assert sorted(longest_step_last(points, shortest_tour(points))) == list(range(count))


def test_points_in_one_place_are_all_visited() -> None:
    assert sorted(shortest_tour(np.zeros((9, 3)))) == list(range(9))


def test_the_longest_step_comes_last() -> None:
    points = np.array([[0.0], [1.0], [10.0], [11.0]])
    order = longest_step_last(points, np.array([1, 2, 3, 0]))
    assert order.tolist() == [0, 1, 2, 3]


def test_a_long_step_goes_by_way_of_the_points_between() -> None:
    """From one end of most of a ring to the other, the way leads along it, not across."""
    angles = np.linspace(0, 5, 31)
    points = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    assert by_way_of_others(points, np.array([0, 30])).tolist() == list(range(31))
    assert by_way_of_others(points, np.array([30, 0, 2])).tolist() == [*range(30, -1, -1), 1, 2]


@pytest.mark.parametrize("stops", [[], [4], [4, 0, 4]])
def test_between_points_in_one_place_the_way_is_straight(stops: list[int]) -> None:
    assert by_way_of_others(np.zeros((9, 3)), np.array(stops, int)).tolist() == stops


def test_a_stop_that_follows_itself_counts_once() -> None:
    assert by_way_of_others(np.eye(5), np.array([4, 4, 1])).tolist() == [4, 1]
