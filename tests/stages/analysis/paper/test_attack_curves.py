"""Areas under curves of attacks: by hand for simple ones, and as an attacker would have it for the others."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stages.analysis.paper.attack_curves import LEAST_LOSS, Curve, Point

COVER, MESSAGE = 30.0, 24.0


def curve(*points: tuple[float, float]) -> Curve:
    """Of what cover and message lose, in dB."""
    shown = (Point(number, COVER - cover, MESSAGE - message) for number, (cover, message) in enumerate(points))
    return Curve(Point(0, COVER, MESSAGE), tuple(shown))


def test_a_straight_line() -> None:
    line = curve((1, 2), (2, 4), (4, 8))
    assert line.message_left(4) == pytest.approx(MESSAGE - 4)
    assert line.message_left(1) == pytest.approx(MESSAGE - 1)
    assert (line.reach, line.gain) == (4, 4)


def test_a_vertical_drop_counts_over_the_whole_width() -> None:
    drop = curve((0, 3), (0, 10))
    assert drop.reach == 0
    assert drop.gain == 10
    for width in (0, 1, 4):
        assert drop.message_left(width) == pytest.approx(MESSAGE - 10)


def test_an_attacker_takes_the_best_of_what_costs_no_more() -> None:
    assert curve((1, 6), (3, 1)).message_left(3) == pytest.approx((MESSAGE - 3 + 2 * (MESSAGE - 6)) / 3)
    assert curve((-0.5, 6)).message_left(2) == pytest.approx(MESSAGE - 6), "an attack that improves the cover is free"


def test_an_attack_that_only_hurts_the_cover_gains_nothing() -> None:
    harmless = curve((1, 0), (4, 0))
    assert harmless.message_left(4) == MESSAGE
    assert harmless.gain == -1


def test_beyond_its_last_point_a_curve_goes_on_level() -> None:
    assert curve((1, 2)).message_left(3) == pytest.approx((1 * (MESSAGE - 1) + 2 * (MESSAGE - 2)) / 3)


def test_without_points_nothing_is_lost() -> None:
    assert curve().message_left(2) == MESSAGE
    assert curve().reach == 0
    assert math.isnan(curve().gain)


losses = st.lists(st.tuples(st.floats(-1, 6), st.floats(-1, 15)), min_size=1, max_size=6)


@given(points=losses, width=st.floats(0, 6))
def test_the_order_of_points_does_not_matter_and_more_points_leave_no_more(
    points: list[tuple[float, float]], width: float
) -> None:
    left = curve(*points).message_left(width)
    assert left == pytest.approx(curve(*reversed(points)).message_left(width))
    assert left <= MESSAGE + 1e-9
    assert curve(*points, (0.0, 20.0)).message_left(width) <= left + 1e-9
    assert left >= min(MESSAGE, *(MESSAGE - message for _, message in points)) - 1e-9


def test_no_width_means_what_is_left_at_next_to_no_loss() -> None:
    assert curve((LEAST_LOSS, 4), (1, 9)).message_left(0) == pytest.approx(MESSAGE - 2)
