"""Figures of the secrecy tables, from the measurements of `probe_secrecy`, by kind of container."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from stages.analysis.measurements import Measurement
from stages.analysis.method_titles import DECODER, METHOD_TITLES, SECOND_HARMONICS
from stages.analysis.paper.measuring import NO_NOISE, Measured, Noise, Spread, spread_of
from stages.analysis.paper.runs import Experiment, Study, capture_title
from stages.analysis.paper.settings import Settings, settings_title
from stages.analysis.secrecy.conditions import BLIND, NOTHING_HIDDEN, OWNER, SURROGATE, SURROGATES
from stages.imaging.metric_table import mean_of_known

M = "feature_dim"

WITHOUT_FEATURES = (SECOND_HARMONICS, DECODER)
"""These have no M."""


@dataclass(frozen=True)
class Kind:
    """Containers that differ only in capture and seed.

    `feature_dim` is M, None for a method without features; `settings` are the other unusual ones.
    """

    method: str
    feature_dim: float | None
    settings: Settings = ()

    @property
    def title(self) -> str:
        """The method's title with M and the other settings.

        >>> Kind("gs_hider", 8.0).title, Kind("sh", None).title
        ('GS-Hider, M = 8', '3DGS+SH')
        >>> Kind("gs_hider", 8.0, (("lambda_message", 0.25),)).title
        'GS-Hider, M = 8, λ = 0.25'
        """
        size: Settings = () if self.feature_dim is None else ((M, self.feature_dim),)
        return settings_title(self.method, (*size, *self.settings))


Found = Mapping[Kind, Sequence[Experiment]]
"""The experiments of each kind of container."""


def kinds(study: Study) -> Found:
    """The experiments that measured secrecy, by kind: methods in the paper's order, the smallest M first."""
    order = list(METHOD_TITLES)
    found: dict[Kind, list[Experiment]] = {}
    for experiment in study.experiments:
        if any(row.condition == OWNER for row in experiment.rows):
            stated = experiment.values.get(M)
            has_features = experiment.method not in WITHOUT_FEATURES and isinstance(stated, int | float)
            others = tuple((name, value) for name, value in experiment.settings if name != M)
            kind = Kind(experiment.method, float(str(stated)) if has_features else None, others)
            found.setdefault(kind, []).append(experiment)
    place = {name: index for index, name in enumerate(order)}

    def position(kind: Kind) -> tuple[int, str, float]:
        return place.get(kind.method, len(order)), str(kind.settings), kind.feature_dim or 0

    return {kind: found[kind] for kind in sorted(found, key=position)}


def by_size(method: str, found: Found) -> dict[str, dict[float, Sequence[Experiment]]]:
    """A method's experiments by M, for each group of containers that differ in nothing else, by the group's title."""
    groups: dict[str, dict[float, Sequence[Experiment]]] = {}
    for kind, experiments in found.items():
        if kind.method == method and kind.feature_dim is not None:
            groups.setdefault(Kind(method, None, kind.settings).title, {})[kind.feature_dim] = experiments
    return groups


def rows_of(
    experiments: Iterable[Experiment], quantity: str, condition: str, severity: float | None = None
) -> list[Measurement]:
    """The measurements of a quantity under a condition, and only at `severity` if it is given."""
    return [
        row
        for experiment in experiments
        for row in experiment.rows
        if row.quantity == quantity and row.condition == condition and severity in (None, row.severity)
    ]


def by_seed(rows: Sequence[Measurement]) -> Spread:
    """The mean and the standard deviation over the seeds of decoders or of surrogates; UNKNOWN without any."""
    return spread_of([value for value in _means_by_seed(rows) if not math.isnan(value)])


def _means_by_seed(rows: Sequence[Measurement]) -> list[float]:
    """For each seed, the mean over views and messages; NaN if nothing was measured."""
    seeds = dict.fromkeys(row.seed for row in rows)
    return [mean_of_known(row.value for row in rows if row.seed == seed) for seed in seeds]


def figure(experiments: Sequence[Experiment], quantity: str, condition: str, severity: float | None = None) -> Spread:
    """The mean over captures, which have equal weights, however many test views they have."""
    return measured(experiments, quantity, condition, severity).average


def measured(
    experiments: Sequence[Experiment], quantity: str, condition: str, severity: float | None = None
) -> Measured:
    """The figure on each capture where it was measured, with its spread over seeds."""
    found = {}
    for capture in dict.fromkeys(experiment.capture for experiment in experiments):
        own = [experiment for experiment in experiments if experiment.capture == capture]
        spread = by_seed(rows_of(own, quantity, condition, severity))
        if spread.count:
            found[capture] = spread
    return Measured(found)


def best_decoder(experiments: Sequence[Experiment], condition: str) -> Measured:
    """On each capture, the figure of the wrong decoder that shows most of the message, if there is more than one."""
    found = {}
    for capture in dict.fromkeys(each.capture for each in experiments):
        rows = rows_of([each for each in experiments if each.capture == capture], "psnr_covered", condition)
        means = _means_by_seed(rows)
        if len(means) > 1:
            found[capture] = Spread(max(means))
    return Measured(found)


def noise_of(*kinds: Measured) -> Noise:
    """Noise from one seed to the next, pooled over the captures of all kinds; NaN if one of them has a single seed."""
    spreads = [spread for kind in kinds for spread in kind.by_capture.values()]
    if not spreads:
        return NO_NOISE
    deviation = math.sqrt(math.fsum(spread.deviation**2 for spread in spreads) / len(spreads))
    return Noise(deviation, sum(spread.count - 1 for spread in spreads))


def behind_owner(experiments: Sequence[Experiment], share: float) -> Measured:
    """PSNR of the best surrogate with this share of the views minus that of the owner's decoder, in dB.

    The owner's decoder does not depend on a surrogate's seed.
    """
    return best_surrogates(experiments, share).minus(measured(experiments, "psnr_covered", OWNER).certain)


def shares(experiments: Sequence[Experiment]) -> tuple[float, ...]:
    """The shares of the training views that leaked to surrogates, ascending."""
    rows = [row for experiment in experiments for row in experiment.rows if row.condition == SURROGATE]
    return tuple(sorted({row.severity for row in rows if row.severity is not None}))


def best_surrogate(experiments: Sequence[Experiment], share: float) -> str:
    """The condition of the surrogate that shows most of the message, among those with this share of the views.

    An attacker can find out which it is by holding back some of these views.
    """
    scores = {each: figure(experiments, "psnr_covered", each, share).mean for each in SURROGATES}
    known = {each: score for each, score in scores.items() if not math.isnan(score)}
    return max(known, key=lambda each: known[each], default=SURROGATE)


def best_surrogates(experiments: Sequence[Experiment], share: float, quantity: str = "psnr_covered") -> Measured:
    """On each capture, a figure of the surrogate that shows most of the message there."""

    def best(own: Sequence[Experiment]) -> Measured:
        return measured(own, quantity, best_surrogate(own, share), share)

    return on_each_capture(experiments, best)


def best_blind(experiments: Sequence[Experiment]) -> str | None:
    """The condition of the blind reading that shows most of the message in true colours; None if there is none.

    Only the owner can tell which it is: this is the most that a blind reader could have picked.
    """
    conditions = blind_conditions(experiments)
    scores = {each: figure(experiments, "psnr_coloured", each).mean for each in conditions}
    return max(scores, key=lambda each: scores[each]) if scores else None


def on_each_capture(experiments: Sequence[Experiment], figures: Callable[[Sequence[Experiment]], Measured]) -> Measured:
    """Figures that are taken on each capture by itself, such as that of the reading that is the best one there."""
    found: dict[str, Spread] = {}
    for capture in dict.fromkeys(each.capture for each in experiments):
        found |= figures([each for each in experiments if each.capture == capture]).by_capture
    return Measured(found)


def blind_conditions(experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """The conditions of blind readings, in order of measurement, without those of the control that hides nothing."""
    conditions = dict.fromkeys(row.condition for experiment in experiments for row in experiment.rows)
    prefix, control = BLIND.format(""), NOTHING_HIDDEN.format("")
    return tuple(each for each in conditions if each.startswith(prefix) and not each.endswith(control))


def captures_of(experiments: Iterable[Experiment]) -> str:
    """The names of the captures, for a caption."""
    return ", ".join(dict.fromkeys(capture_title(experiment.capture) for experiment in experiments))


def all_shares(found: Found) -> list[float]:
    """The shares of leaked views that any of them was measured with, and 0, ascending."""
    return sorted({0.0, *(share for each in found.values() for share in shares(each))})


def all_of(found: Found) -> list[Experiment]:
    """The experiments of all kinds."""
    return [experiment for each in found.values() for experiment in each]
