"""Areas under attack curves: computed by hand for simple ones, and from the attacker's view for the others."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stages.analysis.attacks.catalogue import ONE_COLOUR, UNATTACKED, restored
from stages.analysis.measurements import Measurement
from stages.analysis.paper.attack_curves import (
    LEAST_LOSS,
    Curve,
    MeanPoint,
    Point,
    at_severity,
    average_curve,
    mean_over_seeds,
    measured,
    most_to_lose,
    readings,
    severities,
)
from stages.analysis.paper.runs import Experiment

COVER, MESSAGE = 30.0, 24.0


def curve(*points: tuple[float, float]) -> Curve:
    """A curve from the losses of cover and message, in dB."""
    shown = (Point(number, COVER - cover, MESSAGE - message) for number, (cover, message) in enumerate(points))
    return Curve(Point(0, COVER, MESSAGE), tuple(shown))


def test_captures_weigh_alike_however_often_each_was_trained() -> None:
    def trained(capture: str, message: float, seed: int) -> Experiment:
        rows = [
            Measurement("psnr", value, condition, severity, 0, None, "test", name, "gs_hider")
            for condition, severity in (("none", None), ("noise", 0.1))
            for value, name in ((COVER, None), (message, "statue"))
        ]
        return Experiment(capture, "gs_hider", str(seed), tuple(rows), {})

    averaged = average_curve([*(trained("fox", 24.0, seed) for seed in range(3)), trained("bonsai", 18.0, 0)], "noise")
    assert averaged is not None
    assert averaged.unattacked.message == pytest.approx(21)
    assert [point.message for point in averaged.points] == pytest.approx([21])
    assert average_curve([], "noise") is None


def attacked(capture: str, slope: float, losses: list[list[float]], free: float = 0.0) -> Experiment:
    """A container whose message loses `free` at no cost and `slope` for each dB of the cover's `losses`, by seed."""
    rows = [Measurement("psnr", COVER, UNATTACKED), Measurement("psnr", MESSAGE, UNATTACKED, message="statue")]
    for seed, own in enumerate(losses):
        for number, loss in enumerate(own):
            rows.append(Measurement("psnr", COVER - loss, "noise", number, seed))
            left = MESSAGE - free - slope * loss
            rows.append(Measurement("psnr", left, "noise", number, seed, message="statue"))
            rows.append(Measurement("psnr", left + 1, restored("noise"), number, seed, message="statue"))
    return Experiment(capture, "gs_hider", "0", tuple(rows), {})


def test_captures_that_were_attacked_otherwise_are_averaged_at_equal_shares_of_what_their_covers_lose() -> None:
    """Lines with slopes 1 and 3 up to 4 and 5 dB end at 4.5 dB on average, where messages have lost 4 and 15.

    A third curve loses 9 dB of its message at no cost, so the average starts 3 dB lower.
    """
    both = [attacked("fox", 1, [[0.1, 0.2, 0.3, 4]]), attacked("bonsai", 3, [[1, 5]])]
    averaged = average_curve(both, "noise")
    assert averaged is not None
    assert averaged.unattacked == MeanPoint(COVER, MESSAGE)
    shares = (0, 0.25, 0.5, 0.75, 1)
    assert [point.cover for point in averaged.points] == pytest.approx([COVER - 4.5 * share for share in shares])
    assert [point.message for point in averaged.points] == pytest.approx([MESSAGE - 9.5 * share for share in shares])
    registered = average_curve(both, "noise", restored("noise"))
    assert registered is not None
    assert registered.points[-1].message == pytest.approx(MESSAGE - 9.5 + 1)
    dropping = average_curve([*both, attacked("kitchen", 0, [[0, 6]], free=9)], "noise")
    assert dropping is not None
    assert (dropping.unattacked.message, dropping.points[0].message) == pytest.approx((24, 21))
    assert severities(both, "noise") == (0, 1, 2, 3)


def test_one_seed_or_one_capture_that_loses_little_does_not_shorten_what_is_drawn() -> None:
    seeds = average_curve([attacked("fox", 2, [[2, 4], [2, 4], [0.02, 0.04]])], "noise")
    captures = average_curve([attacked("fox", 2, [[2, 4]]), attacked("bonsai", 2, [[0.02, 0.04]])], "noise")
    for averaged, reach in ((seeds, 8.04 / 3), (captures, 4.04 / 2)):
        assert averaged is not None
        assert len(averaged.points) == 5
        assert averaged.points[-1].cover == pytest.approx(COVER - reach)
        assert averaged.points[-1].message == pytest.approx(MESSAGE - 2 * reach)


def test_the_mean_over_seeds_is_taken_severity_by_severity_where_the_cover_can_be_rendered() -> None:
    averaged = mean_over_seeds([curve((1, 2), (4, 8)), curve((2, 3), (math.nan, 20))])
    assert averaged.unattacked == Point(0, COVER, MESSAGE)
    assert averaged.points == (Point(0, COVER - 1.5, MESSAGE - 2.5), Point(1, COVER - 4, MESSAGE - 8))


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
    better = curve((-0.5, 6))
    assert better.message_left(2) == pytest.approx(MESSAGE - 6), "an attack that improves the cover is free"
    assert (better.reach, better.gain) == (0, 6)


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


def test_what_costs_next_to_nothing_costs_nothing() -> None:
    """At width 0, such a point is what is left of the message; in a wider range, it is a vertical drop."""
    for free in (-0.2, 0, 0.4 * LEAST_LOSS, 0.99 * LEAST_LOSS):
        assert curve((free, 4), (1, 9)).message_left(0) == pytest.approx(MESSAGE - 4)
        assert curve((free, 4)).message_left(3) == pytest.approx(MESSAGE - 4)
    assert curve((1.1 * LEAST_LOSS, 4)).message_left(0) == MESSAGE


def pruned(
    messages: dict[str, tuple[float, float]], floors: dict[str, float], seeds: dict[int, float] | None = None
) -> Experiment:
    """`messages` has each PSNR before and after an attack; `seeds` says how much more each seed takes."""
    rows = [Measurement("psnr", 30.0, UNATTACKED)]
    rows += [Measurement(ONE_COLOUR, value, UNATTACKED, message=name) for name, value in floors.items()]
    for name, (before, _) in messages.items():
        rows.append(Measurement("psnr", before, UNATTACKED, message=name))
    for seed, more in (seeds or {0: 0.0}).items():
        rows.append(Measurement("psnr", 29.0, "cloning", 1.0, seed))
        rows += [
            Measurement("psnr", after - more, "cloning", 1.0, seed, message=name)
            for name, (_, after) in messages.items()
        ]
    return Experiment("fox", "sh", "0", tuple(rows), {})


def test_each_message_that_reads_worse_than_one_colour_reads_as_one() -> None:
    floors = {"statue": 13.0, "reef": 13.0}
    [curve] = readings(pruned({"statue": (25.0, 25.0), "reef": (24.0, 4.0)}, floors), "cloning", "as found")
    assert [point.message for point in curve.points] == [19.0], "and not the mean of 25 and 4"
    [never] = readings(pruned({"statue": (10.0, 2.0)}, {"statue": 13.0}), "cloning", "as found")
    assert never.gain == -1, "who never had a message loses none"
    [without] = readings(pruned({"statue": (10.0, 2.0)}, {}), "cloning", "as found")
    assert (without.unattacked.message, without.points[0].message) == (10.0, 2.0)


def test_a_message_that_no_view_shows_hides_no_other() -> None:
    [curve] = readings(pruned({"statue": (25.0, 20.0), "reef": (math.nan, math.nan)}, {}), "cloning", "as found")
    assert (curve.unattacked.message, [point.message for point in curve.points]) == (25.0, [20.0])


def test_how_far_trainings_lie_apart_is_no_spread_of_an_attacks_seeds() -> None:
    seeds = {0: -0.1, 1: 0.1}
    both = [pruned({"statue": (25.0, after)}, {}, seeds) for after in (19.0, 25.0)]
    left = measured(both, "cloning", "as found", lambda curve: curve.points[0].message).by_capture["fox"]
    there = at_severity(both, "cloning", 1.0, True, "psnr").by_capture["fox"]
    assert left == there
    assert (left.mean, left.count) == (22.0, 2)
    assert left.worth == 2, "of two trainings, however many seeds there are"
    assert left.deviation == pytest.approx(math.hypot(math.sqrt(0.02), math.sqrt(0.02)) / 2)


def test_the_better_reading_is_taken_severity_by_severity() -> None:
    best = curve((1, 2), (2, 9)).better_of(curve((3, 4), (4, 1)))
    assert [point.message for point in best.points] == [22.0, 23.0]
    assert [point.cover for point in best.points] == [29.0, 28.0], "the cover that the attacker publishes"


def test_readings_of_an_experiment() -> None:
    def row(quantity: str, value: float, condition: str, severity: float | None, message: str | None) -> Measurement:
        return Measurement(quantity, value, condition, severity, 0, None, "test", message, "sh")

    found = [row("psnr", 30.0, UNATTACKED, None, None), row("psnr", 24.0, UNATTACKED, None, "statue")]
    found.append(row(ONE_COLOUR, 12.0, UNATTACKED, None, "statue"))
    for severity, before, after in ((1.0, 20.0, 23.0), (2.0, 8.0, 7.0)):
        for condition, message in (("cloning", before), (restored("cloning"), after)):
            found += [row("psnr", 29.0, condition, severity, None), row("psnr", message, condition, severity, "statue")]
    found += [row("psnr", 28.0, "jpeg", 50.0, None), row("psnr", 21.0, "jpeg", 50.0, "statue")]
    experiment = Experiment("fox", "sh", "0", tuple(found), {}, "attacked")
    [as_found], [registered] = (readings(experiment, "cloning", each) for each in ("as found", "registered"))
    assert [point.message for point in as_found.points] == [20.0, 12.0]
    assert [point.message for point in registered.points] == [23.0, 12.0]
    assert readings(experiment, "jpeg", "registered") == readings(experiment, "jpeg", "as found") != ()
    assert readings(experiment, "cropping", "registered") == ()


def test_where_no_cover_can_be_rendered_any_more_nothing_is_gained() -> None:
    lost = Curve(Point(0, COVER, MESSAGE), (Point(1, COVER - 1, MESSAGE - 2), Point(2, math.nan, MESSAGE - 9)))
    assert (lost.reach, lost.gain) == (1, 1)
    assert lost.message_at(5.0) == MESSAGE - 2
    assert lost.message_left(1.0) == pytest.approx(MESSAGE - 1)


def test_a_message_that_no_measured_view_shows_counts_for_nothing() -> None:
    rows = [
        Measurement(quantity, math.nan if name == "reef" else value, condition, severity, 0, message=name)
        for condition, severity in ((UNATTACKED, None), ("random_pruning", 0.25))
        for name, value, quantity in (
            (None, COVER, "psnr"),
            ("statue", MESSAGE, "psnr"),
            ("reef", MESSAGE, "psnr"),
            ("statue", 14.0, ONE_COLOUR),
            ("reef", 14.0, ONE_COLOUR),
        )
    ]
    two = [Experiment("fox", "gs_hider", "0", tuple(rows), {})]
    assert most_to_lose(two).average.mean == MESSAGE - 14
    assert at_severity(two, "random_pruning", 0.25, True, "psnr").average.mean == MESSAGE
