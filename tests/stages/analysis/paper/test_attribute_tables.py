"""The attribute whose histogram gives a container away most."""

from __future__ import annotations

from stages.analysis.attribute_histograms import CHANNELS, DIVERGENCE, of_attribute
from stages.analysis.measurements import Measurement
from stages.analysis.paper.attribute_tables import widest_divergence
from stages.analysis.paper.runs import Experiment
from stages.analysis.picture_classes import CLEAN_AGAIN, HIDDEN


def rows(quantity: str, hidden: float, again: float | None) -> list[Measurement]:
    found = [Measurement(quantity, hidden, HIDDEN)]
    return found if again is None else [*found, Measurement(quantity, again, CLEAN_AGAIN)]


def experiment(*measured: list[Measurement]) -> Experiment:
    return Experiment("fox", "gs_hider", "0", tuple(row for each in measured for row in each), {})


def test_what_two_clean_trainings_differ_by_is_not_held_against_a_container() -> None:
    scales, features = of_attribute(DIVERGENCE, "log_scales"), of_attribute(CHANNELS, "raw_features")
    told = widest_divergence([experiment(rows(scales, 0.09, 0.01), rows(features, 0.43, 0.42))])
    assert told == "log_scales: 0.090 bits from a clean one; between two clean ones, 0.010"


def test_without_the_control_nothing_is_said() -> None:
    assert widest_divergence([experiment(rows(of_attribute(DIVERGENCE, "log_scales"), 0.09, None))]) == ""
    assert widest_divergence([]) == ""
