"""Figures of secrecy as the tables take them: read off the measurements of `probe_secrecy`, container by container."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from stages.analysis.measurements import Measurement
from stages.analysis.page.material import METHOD_TITLES
from stages.analysis.paper.measuring import Measured, Spread
from stages.analysis.paper.runs import Experiment, Study, capture_title
from stages.analysis.secrecy.conditions import BLIND, NOTHING_HIDDEN, OWNER, SURROGATE

HARMONICS = ("sh", "decoder")
"""Methods without features, and so without M."""


@dataclass(frozen=True)
class Kind:
    """Containers that differ in capture and seed alone: `feature_dim` is M, None for a method without features."""

    method: str
    feature_dim: float | None

    @property
    def title(self) -> str:
        """The method as it is shown, and M.

        >>> Kind("gs_hider", 8.0).title, Kind("sh", None).title
        ('GS-Hider, M = 8', '3DGS+SH')
        """
        name = METHOD_TITLES.get(self.method, self.method)
        return name if self.feature_dim is None else f"{name}, M = {self.feature_dim:g}"


Found = Mapping[Kind, Sequence[Experiment]]
"""The experiments of each kind of container."""


def kinds(study: Study) -> Found:
    """The experiments that measured secrecy: methods in the paper's order, the smallest M first."""
    order = list(METHOD_TITLES)
    found: dict[Kind, list[Experiment]] = {}
    for experiment in study.experiments:
        if any(row.condition == OWNER for row in experiment.rows):
            stated = experiment.values.get("feature_dim")
            has_features = experiment.method not in HARMONICS and isinstance(stated, int | float)
            kind = Kind(experiment.method, float(str(stated)) if has_features else None)
            found.setdefault(kind, []).append(experiment)
    place = {name: index for index, name in enumerate(order)}
    return dict(
        sorted(found.items(), key=lambda item: (place.get(item[0].method, len(order)), item[0].feature_dim or 0))
    )


def rows_of(
    experiments: Iterable[Experiment], quantity: str, condition: str, severity: float | None = None
) -> list[Measurement]:
    """The measurements of a quantity under a condition, of a severity where one is given."""
    return [
        row
        for experiment in experiments
        for row in experiment.rows
        if row.quantity == quantity and row.condition == condition and severity in (None, row.severity)
    ]


def mean_over(rows: Sequence[Measurement]) -> float:
    """Over views, messages and seeds; NaN where nothing was measured."""
    values = [row.value for row in rows if not math.isnan(row.value)]
    return math.fsum(values) / len(values) if values else math.nan


def by_seed(rows: Sequence[Measurement]) -> Spread:
    """The mean, and the standard deviation from one seed, of decoders or of surrogates, to the next."""
    means = [mean_over([row for row in rows if row.seed == seed]) for seed in dict.fromkeys(row.seed for row in rows)]
    means = [value for value in means if not math.isnan(value)]
    if not means:
        return Spread(math.nan)
    middle = math.fsum(means) / len(means)
    if len(means) < 2:
        return Spread(middle, math.nan, len(means))
    variance = math.fsum((value - middle) ** 2 for value in means) / (len(means) - 1)
    return Spread(middle, math.sqrt(variance), len(means), len(means))


def figure(experiments: Sequence[Experiment], quantity: str, condition: str, severity: float | None = None) -> Spread:
    """`by_seed` of what `rows_of` finds."""
    return by_seed(rows_of(experiments, quantity, condition, severity))


def measured(
    experiments: Sequence[Experiment], quantity: str, condition: str, severity: float | None = None
) -> Measured:
    """The figure of each capture where it was measured."""
    found = {}
    for capture in dict.fromkeys(experiment.capture for experiment in experiments):
        own = [experiment for experiment in experiments if experiment.capture == capture]
        spread = figure(own, quantity, condition, severity)
        if spread.count:
            found[capture] = spread
    return Measured(found)


def shares(experiments: Sequence[Experiment], condition: str = SURROGATE) -> tuple[float, ...]:
    """The shares of the training views that leaked to surrogates, ascending."""
    rows = [row for experiment in experiments for row in experiment.rows if row.condition == condition]
    return tuple(sorted({row.severity for row in rows if row.severity is not None}))


def best_blind(experiments: Sequence[Experiment]) -> str | None:
    """The condition of the blind reading that shows most of the message in true colours; None where there is none.

    Which it is, only the owner can tell: this is the most that a blind reader could have picked.
    """
    conditions = blind_conditions(experiments)
    scores = {each: figure(experiments, "psnr_coloured", each).mean for each in conditions}
    return max(scores, key=lambda each: scores[each]) if scores else None


def blind_conditions(experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """The conditions of blind readings, in the order measured; not those of the control that hides nothing."""
    conditions = dict.fromkeys(row.condition for experiment in experiments for row in experiment.rows)
    prefix, control = BLIND.format(""), NOTHING_HIDDEN.format("")
    return tuple(each for each in conditions if each.startswith(prefix) and not each.endswith(control))


def captures_of(experiments: Iterable[Experiment]) -> str:
    """Their names, for a caption."""
    return ", ".join(dict.fromkeys(capture_title(experiment.capture) for experiment in experiments))


def all_shares(found: Found) -> list[float]:
    """The shares that any of them was measured with, and 0, ascending."""
    return sorted({0.0, *(share for each in found.values() for share in shares(each))})


def all_of(found: Found) -> list[Experiment]:
    """The experiments of all kinds."""
    return [experiment for each in found.values() for experiment in each]
