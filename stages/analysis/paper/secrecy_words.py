"""What is not secure, container by container, in words made from the figures."""

from __future__ import annotations

import math
from collections.abc import Sequence

from stages.analysis.paper.runs import Experiment
from stages.analysis.paper.secrecy_figures import Found, Kind, best_surrogate, blind_conditions, figure, shares
from stages.analysis.secrecy.conditions import BLIND, COVER_ITSELF, NOTHING_HIDDEN, OPEN, OWN_START, OWNER

RECOGNISABLE = 0.1
"""The multiple correlation with the message is more than chance if it exceeds that of the control by more than this."""


def words_on(found: Found) -> list[str]:
    """A sentence for each kind of container that is not secure."""
    return [sentence for kind, experiments in found.items() if (sentence := _sentence(kind, experiments))]


def _sentence(kind: Kind, experiments: Sequence[Experiment]) -> str:
    opened = figure(experiments, "psnr_covered", OPEN)
    if opened.count:
        return f"{kind.title} keeps nothing secret: the published file alone shows the message at {opened.mean:.2f} dB."
    found = [*_of_the_container_alone(experiments), *_of_surrogates(experiments), *_of_the_seed(experiments)]
    return f"{kind.title} is not secure against {'; '.join(found)}." if found else ""


def _of_the_container_alone(experiments: Sequence[Experiment]) -> list[str]:
    """Words on the blind reading that most exceeds its controls; it need not be the one with the most decibels."""
    readings = [(*_beside_chance(experiments, each), each) for each in blind_conditions(experiments)]
    known = [reading for reading in readings if not math.isnan(reading[0] - reading[1])]
    if not known:
        return []
    related, chance, blind = max(known, key=lambda reading: reading[0] - reading[1])
    if not related - chance > RECOGNISABLE:
        return []
    way = blind.removeprefix(BLIND.format(""))
    return [
        f"anyone with just the container: three channels of its feature map (reading {way!r}) show the message "
        f"(r = {related:.2f}, control {chance:.2f}) to a reader who has seen nothing of it"
    ]


def _beside_chance(experiments: Sequence[Experiment], blind: str) -> tuple[float, float]:
    """A blind reading's correlation with the message, and the largest of its controls; NaN without any."""
    related, others = _related(experiments, blind, None)
    chances = [figure(experiments, "correlation", each).mean for each in (NOTHING_HIDDEN.format(blind), COVER_ITSELF)]
    return related, max((each for each in (others, *chances) if not math.isnan(each)), default=math.nan)


def _of_surrogates(experiments: Sequence[Experiment]) -> list[str]:
    owner, floor = (figure(experiments, name, OWNER).mean for name in ("psnr_covered", "psnr_constant"))
    parts = []
    for share in (each for each in shares(experiments) if each > 0):
        best = best_surrogate(experiments, share)
        shown = figure(experiments, "psnr_covered", best, share).mean
        related, others = _related(experiments, best, share)
        if related - others > RECOGNISABLE:
            way = max(shown - floor, 0.0) / (owner - floor) if owner > floor else 0.0
            parts.append(f"{way:.0%} with {share:.0%} of them (r = {related:.2f}, control {others:.2f})")
    start = (
        "anyone with views of the message: of the way from one colour to the owner's decoder, in dB, the best "
        "surrogate covers "
    )
    return [start + ", ".join(parts)] if parts else []


def _of_the_seed(experiments: Sequence[Experiment]) -> list[str]:
    related, others = _related(experiments, OWN_START, None)
    if not related - others > RECOGNISABLE:
        return []
    return [
        "anyone who guesses the seed of a training without a key: the decoder's initial weights show the message, "
        f"untrained and without a single view of it (r = {related:.2f}, control {others:.2f})"
    ]


def _related(experiments: Sequence[Experiment], condition: str, share: float | None) -> tuple[float, float]:
    """The correlation with the message and, as its control, with other views' messages, or else the cover's."""
    own, others = (figure(experiments, name, condition, share).mean for name in ("correlation", "correlation_others"))
    return own, figure(experiments, "correlation", COVER_ITSELF).mean if math.isnan(others) else others
