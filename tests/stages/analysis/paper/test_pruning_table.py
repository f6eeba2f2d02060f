"""The error that pruning adds tells the loss of a good picture from that of a bad one."""

from __future__ import annotations

import math

import pytest

from stages.analysis.measurements import Measurement
from stages.analysis.paper.pruning_table import added_psnr, pruning_relations
from stages.analysis.paper.published import read_published
from stages.analysis.paper.runs import Experiment


def test_twice_the_error_is_as_much_again() -> None:
    assert added_psnr(30.0, 30.0 - 10 * math.log10(2)) == pytest.approx(30.0)
    assert added_psnr(30.0, 30.0) == math.inf
    assert added_psnr(30.0, 31.0) == math.inf
    assert math.isnan(added_psnr(30.0, math.nan))


@pytest.mark.parametrize("condition", ["sequential_pruning", "channel_permutation"])
def test_of_attacks_that_were_not_made_nothing_is_asked(condition: str) -> None:
    rows = tuple(
        Measurement("psnr", 30.0, each, severity, 0, None, "test", None, "gs_hider")
        for each, severity in (("none", None), (condition, 0.15))
    )
    groups = {"gs_hider": (Experiment("fox", "gs_hider", "0", rows, {}, "attacked[fox]"),)}
    assert not [each for each in pruning_relations(groups, read_published()) if "at random" in each.text]


@pytest.mark.parametrize(("before", "after", "verdict"), [(31.0, 27.0, "holds"), (31.0, 24.0, "does not hold")])
def test_the_bar_is_what_pruning_adds_in_the_paper(before: float, after: float, verdict: str) -> None:
    rows = tuple(
        Measurement("psnr", value, condition, severity, 0, None, "test", None, "gs_hider")
        for condition, severity, value in (("none", None, before), ("random_pruning", 0.25, after))
    )
    groups = {"gs_hider": (Experiment("fox", "gs_hider", "0", rows, {}, "attacked[fox]"),)}
    [addition] = [each for each in pruning_relations(groups, read_published()) if "adds" in each.text]
    assert addition.published == pytest.approx(added_psnr(25.817, 23.004), abs=0.01)
    assert addition.verdict == verdict
