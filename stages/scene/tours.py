"""Short tours: an order in which to visit points with little detour."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import cdist

SMALLEST_GAIN = 1e-12
"""Fraction of the largest distance between points; a smaller gain is a rounding error."""

SHORTEST_EDGE = 1e-6
"""Fraction of a graph's longest edge: SciPy takes weights near 0 for missing edges, and points may coincide."""


def shortest_tour(points: Float[np.ndarray, "N D"]) -> Int[np.ndarray, " N"]:
    """The order of a closed tour that no exchange of two of its steps makes shorter (2-opt, Croes 1958).

    It starts at the first point. The initial tour always goes on to the nearest unvisited point. N = 0 is allowed. The
    time is cubic in N: a second for a few hundred points.
    """
    distances = cdist(points, points)
    order = _nearest_first(distances)
    least = SMALLEST_GAIN * (distances.max() if distances.size else 0)
    while len(order) > 3:
        after = np.roll(order, -1)
        kept = distances[order, after]
        gains = kept[:, None] + kept - distances[np.ix_(order, order)] - distances[np.ix_(after, after)]
        first, last = np.unravel_index(np.argmax(np.triu(gains, 2)), gains.shape)
        if np.triu(gains, 2)[first, last] <= least:
            break
        order[first + 1 : last + 1] = order[first + 1 : last + 1][::-1].copy()
    return order


def longest_step_last(points: Float[np.ndarray, "N D"], order: Int[np.ndarray, " N"]) -> Int[np.ndarray, " N"]:
    """The same closed tour, rotated so that its longest step is the one from its end to its beginning."""
    if len(order) < 2:
        return order
    steps = step_lengths(points[np.append(order, order[0])])
    return np.roll(order, -1 - int(np.argmax(steps)))


def by_way_of_others(points: Float[np.ndarray, "N D"], stops: Int[np.ndarray, " K"]) -> Int[np.ndarray, " L"]:
    """The way through `stops`, as rows of points: a long step goes by way of points that lie between, if any.

    The L rows include the stops; a stop that follows itself counts once, and no stops give no rows. The way minimises
    the sum of squared steps, for which many short ones cost less than one long. Points must be finite. The time is
    cubic in N: a tenth of a second for a few hundred points.
    """
    if len(stops) < 2:
        return stops
    squares = cdist(points, points, "sqeuclidean")
    squares = np.maximum(squares / (squares.max() or 1), SHORTEST_EDGE)
    _, before = shortest_path(squares, method="FW", return_predecessors=True)
    way = [int(stops[-1])]
    for start, end in zip(stops[-2::-1], stops[:0:-1], strict=True):
        at = int(end)
        while at != start:
            at = int(before[start, at])
            way.append(at)
    return np.array(way[::-1], int)


def step_lengths(points: Float[np.ndarray, "N D"]) -> Float[np.ndarray, " n"]:
    """The N - 1 distances from each point to the next."""
    return np.linalg.norm(np.diff(points, axis=0), axis=1)


def _nearest_first(distances: Float[np.ndarray, "N N"]) -> Int[np.ndarray, " N"]:
    left = np.ones(len(distances), bool)
    order: list[int] = []
    while left.any():
        here = int(np.where(left, distances[order[-1]], np.inf).argmin()) if order else 0
        order.append(here)
        left[here] = False
    return np.array(order, int)
