from __future__ import annotations

import math
from dataclasses import replace

import pytest

from stages.analysis.paper.measuring import Measured, MeasuredErrors, Noise, Spread, cover, measure, message, noise
from stages.analysis.paper.relations import OnEachCapture, Relation, relations_grid
from stages.analysis.paper.runs import Run
from stages.imaging.metric_table import MetricRow


def run(
    psnr: float, capture: str = "fox", other: tuple[str, ...] = (), method: str = "gs_hider", seed: str = ""
) -> Run:
    """A run with its figure as its seed, unless one is given."""
    return Run(capture, method, (), seed or f"{psnr}", (MetricRow("psnr", psnr, "dB", "a", "test"),), other)


PSNR = cover("psnr")


def test_seeds_have_a_mean_and_a_spread() -> None:
    measured = measure([run(24.0), run(25.0), run(26.0), run(20.0, "bonsai"), run(math.nan, "kitchen")], PSNR)
    assert measured.by_capture["fox"] == Spread(25.0, 1.0, 3, 3)
    assert measured.on("bonsai") == 20.0
    assert math.isnan(measured.by_capture["bonsai"].deviation)
    assert "kitchen" not in measured.by_capture
    assert measured.average.mean == 22.5
    assert math.isnan(measured.average.deviation)
    assert math.isnan(measure([], PSNR).average.mean)


def test_the_average_of_captures_with_several_seeds_has_a_spread() -> None:
    measured = measure([run(24.0), run(26.0), run(20.0, "bonsai"), run(22.0, "bonsai")], PSNR)
    assert measured.average.mean == 23.0
    assert measured.average.deviation == pytest.approx(math.sqrt(2 + 2) / 2)


def test_the_average_of_one_capture_counts_its_seeds() -> None:
    assert measure([run(24.0), run(25.0), run(26.0)], PSNR).average == Spread(25.0, 1.0, 3, 3)


def test_an_average_counts_the_runs_of_a_capture_and_not_the_captures() -> None:
    runs = [run(psnr, capture) for capture in ("fox", "bonsai", "kitchen", "garden") for psnr in (24.0, 25.0, 26.0)]
    assert measure(runs, PSNR).average.count == 3
    assert measure([*runs, run(20.0, "counter")], PSNR).average.count == 1


def test_errors_are_averaged_as_errors() -> None:
    def average(*decibels: float) -> float:
        return MeasuredErrors({str(number): Spread(value) for number, value in enumerate(decibels)}).average.mean

    assert average(20.0, 10.0) == pytest.approx(-10 * math.log10((0.01 + 0.1) / 2))
    assert average(20.0, math.inf) == pytest.approx(20 + 10 * math.log10(2)), "a capture without an error"
    assert average(math.inf, math.inf) == math.inf
    assert average(20.0) == 20.0
    seeds = {capture: Spread(20.0, 0.5, 3, 3) for capture in ("fox", "bonsai")}
    assert math.isnan(MeasuredErrors(seeds).average.deviation)
    assert math.isnan(average())


def test_other_messages_are_no_seeds() -> None:
    measured = measure([run(24.0, other=("message=reef",)), run(26.0, other=("message=fox",))], PSNR)
    assert measured.on("fox") == 25.0
    assert math.isnan(measured.by_capture["fox"].deviation)
    more = [run(24.0, other=("message=reef",)), *(run(psnr, other=("message=fox",)) for psnr in (26.0, 27.0, 28.0))]
    assert measure(more, PSNR).by_capture["fox"].worth == pytest.approx(1 / ((1 + 1 / 3) / 4))
    assert noise([run(24.0, other=("message=reef",)), run(26.0, other=("message=fox",))], PSNR).count == 0


def test_noise_is_pooled_over_what_differs_in_seed_alone() -> None:
    runs = [run(24.0), run(26.0), run(20.0, method="sh"), run(21.0, method="sh"), run(19.0, method="sh"), run(9, "b")]
    found = noise(runs, PSNR)
    assert found.deviation == pytest.approx(math.sqrt((2 + 2) / (1 + 2)))
    assert found.count == 5
    assert noise([run(24.0), replace(run(26.0), settings=(("lambda_message", 1.0),))], PSNR).count == 0
    assert math.isnan(noise(runs[-1:], PSNR).deviation)
    assert noise([*runs, run(math.inf)], PSNR) == found, "a picture without an error tells no noise"


def test_what_has_the_same_seed_tells_no_noise() -> None:
    """Runs with the same seed must differ in something else, which is no noise between seeds."""
    alike = [run(24.0, seed="0"), run(26.0, seed="0")]
    assert noise(alike, PSNR).count == 0
    assert measure(alike, PSNR).by_capture["fox"].count == 1
    found = noise([*alike, run(27.0, seed="1")], PSNR)
    assert (found.deviation, found.count) == (pytest.approx(math.sqrt(2)), 2)


def test_differences_and_ratios_are_of_captures_that_both_have() -> None:
    one = Measured({"fox": Spread(3.0), "bonsai": Spread(8.0), "kitchen": Spread(math.inf)})
    two = Measured({"fox": Spread(2.0), "garden": Spread(4.0), "bonsai": Spread(0.0), "kitchen": Spread(math.inf)})
    assert {name: spread.mean for name, spread in one.minus(two).by_capture.items()} == {"fox": 1.0, "bonsai": 8.0}
    assert {name: spread.mean for name, spread in one.over(two).by_capture.items()} == {"fox": 1.5}


def hiding(name: str, psnr: float, method: str) -> Run:
    """A run that hides the scene `name`."""
    return replace(run(psnr, method=method, other=(f"message={name}",)), hidden=name)


def test_what_one_row_lacks_the_others_do_not_have_over_it() -> None:
    """GS-Hider is 1.5 dB above, with each message and so with the only one of which both rows were made."""
    hider = measure([hiding("kitchen", 18.0, "gs_hider"), hiding("bonsai", 26.0, "gs_hider")], PSNR)
    one = measure([hiding("bonsai", 24.5, "sh")], PSNR)
    both = measure([hiding("kitchen", 16.5, "sh"), hiding("bonsai", 24.5, "sh")], PSNR)
    assert hider.minus(both).on("fox") == hider.minus(one).on("fox") == 1.5
    assert one.minus(hider).on("fox") == -1.5
    assert hider.minus(one).by_capture["fox"].worth == 0.5, "one run beside one"
    assert hider.minus(both).by_capture["fox"].worth == 1.0
    nothing = measure([run(20.0, method="plain")], PSNR)
    assert hider.minus(nothing).on("fox") == 2.0, "plain 3DGS is beside all"
    assert not one.minus(measure([hiding("kitchen", 16.5, "gs_hider")], PSNR)).by_capture


def test_legal_views_of_each_message_apart() -> None:
    rows = [
        MetricRow("psnr", value, "dB", view, "test", name)
        for name, view, value in (("reef", "a", 20.0), ("reef", "b", 10.0), ("fox", "a", 30.0), ("fox", "b", 26.0))
    ]
    flags = [
        MetricRow("legal", float(view == "a" or name == "fox"), "", view, "test", name)
        for name, view in (("reef", "a"), ("reef", "b"), ("fox", "a"), ("fox", "b"))
    ]
    hiding = Run("fox", "gs_hider", (), "", (*rows, *flags))
    assert message("psnr")(hiding) == (15 + 28) / 2
    assert message("psnr", only_legal=True)(hiding) == (20 + 28) / 2
    assert math.isnan(cover("psnr")(hiding))


def relation(values: list[float], bound: float = 0.0, noise: float = math.nan, sense: str = "more than") -> Relation:
    measured = Measured({str(number): Spread(value) for number, value in enumerate(values)})
    return Relation("", "difference", sense, bound, measured, noise=Noise(noise, math.inf))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (relation([]), "not measured"),
        (relation([0.5, 1.0]), "holds"),
        (relation([0.5, -0.1]), "holds, on 1 of 2 captures"),
        (relation([0.5, -0.1, -0.1]), "holds only on average (individually on 1 of 3 captures)"),
        (relation([0.1, 0.1, -0.5]), "does not hold (individually on 2 of 3 captures)"),
        (relation([-0.5]), "does not hold"),
        (relation([0.0]), "does not hold"),
        (relation([0.0], sense="at least"), "holds"),
        (relation([-1.5], -1.4, 0.04, "at least"), "does not hold"),
        (relation([-1.5], -1.4, 0.06, "at least"), "does not hold, within noise"),
        (relation([0.2, 0.3, -0.2], 0.0, 0.08), "holds, on 2 of 3 captures"),
        (relation([0.2, 0.3, -0.2], 0.0, 0.09), "holds, within noise, on 2 of 3 captures"),
        (relation([0.59], 0.6, sense="at most"), "holds"),
        (relation([0.3], 0.3, sense="less than"), "does not hold"),
    ],
)
def test_verdicts(found: Relation, verdict: str) -> None:
    assert found.verdict == verdict


@pytest.mark.parametrize(("value", "written"), [(0.01, "+0.01 dB"), (-0.01, "-0.01 dB"), (-0.001, "0.00 dB")])
def test_a_difference_that_rounds_to_nothing_has_no_sign(value: float, written: str) -> None:
    [line] = relations_grid([("", relation([value]))], ["0"]).lines
    assert line.cells[1].text == written


@pytest.mark.parametrize(
    ("values", "noise", "verdict"),
    [
        ([], 0.01, "not measured"),
        ([0.5, 0.5], 0.01, "holds"),
        ([0.5, 0.59], 0.01, "holds, within noise"),
        ([0.4, 0.5, 0.63], 0.01, "holds only on average (individually on 2 of 3 captures)"),
        ([0.4, 0.5, 0.61], 0.01, "holds only on average, within noise (individually on 2 of 3 captures)"),
        ([0.59, 1.0], 0.01, "does not hold (individually on 1 of 2 captures)"),
        ([0.7, 1.0], 0.01, "does not hold"),
    ],
)
def test_what_is_not_secure_on_one_capture_is_not_secure(values: list[float], noise: float, verdict: str) -> None:
    measured = Measured({str(number): Spread(value) for number, value in enumerate(values)})
    assert OnEachCapture("", "ratio", "at most", 0.6, measured, noise=Noise(noise, math.inf)).verdict == verdict


def test_on_each_capture_noise_is_that_of_the_worst_one() -> None:
    """The mean of four runs has half the noise of one."""

    def verdict(sense: str, *spreads: Spread) -> str:
        measured = Measured({str(number): spread for number, spread in enumerate(spreads)})
        return OnEachCapture("", "ratio", sense, 0.6, measured, noise=Noise(0.01, math.inf)).verdict  # type: ignore[arg-type]

    assert verdict("at least", Spread(0.61), Spread(2.0)) == "holds, within noise"
    assert verdict("at least", Spread(0.64), Spread(2.0)) == "holds"
    assert verdict("at most", Spread(0.588), Spread(0.1)) == "holds, within noise"
    assert verdict("at most", Spread(0.588, worth=4.0), Spread(0.1)) == "holds"


def test_few_runs_tell_no_deviation_for_sure() -> None:
    """Student's t is 4.30 for three runs (two degrees of freedom), and 2.02 for three on each of twenty captures."""
    three = [run(24.0), run(25.0), run(26.0)]
    many = [run(psnr, f"capture {number}") for number in range(20) for psnr in (24.0, 25.0, 26.0)]
    found = [noise(runs, PSNR) for runs in (three, many)]
    assert [each.deviation for each in found] == [1.0, 1.0]
    assert [each.reach for each in found] == pytest.approx([4.303, 2.021], abs=1e-3)


def test_noise_of_what_is_compared_follows_from_how_many_runs_it_is_made_of() -> None:
    """Means over seeds and captures, and their differences, if single runs have a standard deviation of 1."""
    own = measure([run(24.0), run(25.0), run(26.0), run(20.0, "bonsai")], PSNR)
    other = measure([run(23.0), run(19.0, "bonsai")], PSNR)
    variances = {"fox": 1 / 3 + 1, "bonsai": 1 + 1}
    difference = own.minus(other)
    assert {name: 1 / spread.worth for name, spread in difference.by_capture.items()} == pytest.approx(variances)
    assert 1 / difference.average.worth == pytest.approx(sum(variances.values()) / 4)
    assert own.minus(other.certain).by_capture["fox"].worth == own.by_capture["fox"].worth == 3
