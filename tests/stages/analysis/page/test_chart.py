from __future__ import annotations

import math

import pytest

from stages.analysis.page.chart import Chart, Series, line_chart


def drawn(chart: Chart | None) -> list[list[tuple[float, float]]]:
    assert chart is not None
    return [[tuple(map(float, point.split(","))) for point in line.split()] for _, line in chart.lines]


def test_lines_stay_inside_the_axes_and_keep_their_order() -> None:
    rising = Series("rising", tuple((step, step**2) for step in range(0, 1001, 100)))
    flat = Series("flat", ((0, 500_000), (1000, 500_000)))
    chart = line_chart("two", [rising, flat])
    first, second = drawn(chart)
    assert chart is not None
    assert [name for name, _ in chart.lines] == ["rising", "flat"]
    assert all(chart.left <= x <= chart.right and chart.top <= y <= chart.bottom for x, y in first + second)
    assert [y for _, y in first] == sorted((y for _, y in first), reverse=True)  # SVG counts downwards
    assert second[0][1] == second[1][1] == pytest.approx((first[0][1] + first[-1][1]) / 2, abs=0.1)


def test_a_line_has_its_colour_whichever_others_there_are() -> None:
    line = ((0.0, 1.0), (1.0, 2.0))
    chart = line_chart("two of three", [Series("first", line), Series("absent", ()), Series("third", line)])
    assert chart is not None
    assert [name for name, _ in chart.lines] == ["first", "third"]
    assert chart.looks == (0, 2)


def test_a_line_over_another_is_dashed_so_that_both_are_seen() -> None:
    low, high = ((0.0, 1.0), (1.0, 2.0), (2.0, 2.0)), ((0.0, 1.0), (1.0, 2.0), (2.0, 5.0))
    crossing = ((0.0, 5.0), (2.0, 1.0))
    names = [Series("first", low), Series("crossing", crossing), Series("partly", high), Series("again", low)]
    chart = line_chart("four", [*names, Series("a point", ((1.0, 1.5),)), Series("the same", ((1.0, 1.5),))])
    assert chart is not None
    assert chart.over == (0, 0, 1, 2, 0, 1)


def test_equal_factors_are_equal_distances_on_a_logarithmic_axis() -> None:
    [line] = drawn(line_chart("loss", [Series("loss", ((0, 1), (10, 0.1), (20, 0.01)))], logarithmic=True))
    assert line[1][1] - line[0][1] == pytest.approx(line[2][1] - line[1][1], abs=0.11)


@pytest.mark.parametrize("logarithmic", [False, True])
@pytest.mark.parametrize("values", [(0.031, 0.032), (1e-4, 3e3), (27.0, 27.0), (5.0, 5.4)])
def test_axes_have_some_round_ticks_at_their_values(values: tuple[float, float], logarithmic: bool) -> None:
    chart = line_chart("any", [Series("any", ((0, values[0]), (1200, values[1])))], logarithmic)
    assert chart is not None
    assert 2 <= len(chart.across) <= 9
    assert 2 <= len(chart.upward) <= 12
    assert len({tick.text for tick in chart.upward}) == len(chart.upward)
    assert all(chart.top <= tick.position <= chart.bottom for tick in chart.upward)


@pytest.mark.parametrize("points", [((3.0, 1.0),), ((3.0, 1.0), (3.0, 1.0))])
def test_a_line_without_length_is_seen_all_the_same(points: tuple[tuple[float, float], ...]) -> None:
    other = Series("other", ((0.0, 0.0), (6.0, 2.0)))
    [short, _] = drawn(line_chart("short", [Series("short", points), other]))
    assert short[-1][0] - short[0][0] >= 6


def test_what_cannot_be_drawn_is_left_out() -> None:
    holes = Series("holes", ((0, math.nan), (1, 2), (2, math.inf), (3, 1)))
    assert len(drawn(line_chart("holes", [holes]))[0]) == 2
    assert line_chart("nothing", [Series("nan", ((0, math.nan),))]) is None
    assert line_chart("nothing", []) is None
    assert line_chart("nothing", [Series("zero", ((0, 0),))], logarithmic=True) is None


def test_an_axis_that_does_not_begin_at_zero_begins_at_its_values() -> None:
    series = [Series("cover over message", ((26.0, 20.0), (28.0, 24.0), (30.0, 25.0)))]
    chart = line_chart("curve", series, from_zero=False, axes=("Cover (dB)", "Message (dB)"))
    assert chart is not None
    assert chart.axes == ("Cover (dB)", "Message (dB)")
    [line] = drawn(chart)
    assert line[0][0] < chart.left + 0.1 * (chart.right - chart.left)
    assert line[-1][0] > chart.right - 0.1 * (chart.right - chart.left)
    assert all(25 < float(tick.text) < 31 for tick in chart.across)


def test_no_number_stands_at_an_axis_twice() -> None:
    """An attack may cost the cover next to nothing; the axis is not stretched to show so little."""
    series = [Series("one", ((30.0101, 22.4), (30.0101, 19.9))), Series("other", ((30.0102, 22.4), (30.01015, 11.2)))]
    chart = line_chart("curve", series, from_zero=False, axes=("Cover (dB)", "Message (dB)"))
    assert chart is not None
    labels = [tick.text for tick in chart.across]
    assert len(labels) == len(set(labels)) >= 3
    across = [x for line in drawn(chart) for x, _ in line]
    assert max(across) - min(across) < 1
