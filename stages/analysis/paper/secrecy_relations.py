"""What secrecy requires, and what the paper says of small M, each with its verdict, flattering or not."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from stages.analysis.paper.measuring import NO_NOISE, Measured, Noise
from stages.analysis.paper.relations import MOST_OVER_ONE_COLOUR, OnEachCapture, Relation
from stages.analysis.paper.runs import Experiment
from stages.analysis.paper.secrecy_figures import (
    Found,
    Kind,
    behind_owner,
    best_blind,
    best_decoder,
    best_surrogates,
    by_size,
    measured,
    noise_of,
    on_each_capture,
    shares,
)
from stages.analysis.secrecy.conditions import COVER_ITSELF, OPEN, OTHER_START, OWNER, RANDOM

READERS = ((RANDOM, "the best random decoder"), (OTHER_START, "the best decoder started with another key"))


def secrecy_relations(found: Found) -> list[Relation]:
    """What wrong decoders, surrogates and blind readings show of each kind of container, and whether small M leaks."""
    relations = []
    for kind, experiments in found.items():
        relations += _of_kind(kind, experiments)
    for method in dict.fromkeys(kind.method for kind in found):
        relations += _small_features(method, found)
    return relations


def _of_kind(kind: Kind, experiments: Sequence[Experiment]) -> list[Relation]:
    opened = measured(experiments, "psnr_covered", OPEN)
    if opened.by_capture:
        return [_over_one_colour(f"{kind.title}: message over one colour, public attributes", opened, experiments)]
    relations = [
        _over_one_colour(f"{kind.title}: message over one colour, {words}", shown, experiments)
        for condition, words in READERS
        if (shown := best_decoder(experiments, condition)).by_capture
    ]
    if best_blind(experiments) is not None:
        relations.append(_blind_relation(kind, experiments))
    for share in shares(experiments):
        if share > 0:
            text = f"{kind.title}: message over one colour, the best surrogate with {share:.0%} of the views"
            shown = best_surrogates(experiments, share)
            relations.append(_over_one_colour(text, shown, experiments, noise_of(shown)))
    return relations


def _over_one_colour(
    text: str, shown: Measured, experiments: Sequence[Experiment], noise: Noise = NO_NOISE
) -> Relation:
    floor = measured(experiments, "psnr_constant", OWNER)
    return OnEachCapture(
        text, "difference", "at most", MOST_OVER_ONE_COLOUR, shown.minus(floor.certain), math.nan, noise
    )


def _blind_relation(kind: Kind, experiments: Sequence[Experiment]) -> Relation:
    """On each capture, its best blind reading compared with the cover itself, both in true colours."""
    shown = on_each_capture(experiments, lambda own: measured(own, "psnr_coloured", best_blind(own) or ""))
    control = measured(experiments, "psnr_coloured", COVER_ITSELF)
    text = f"{kind.title}: message over the cover itself, both in true colours, the best blind reading"
    return OnEachCapture(text, "difference", "at most", MOST_OVER_ONE_COLOUR, shown.minus(control))


def _small_features(method: str, found: Found) -> list[Relation]:
    """The smallest M compared with the largest: how far the best surrogate is behind the owner's decoder.

    The paper says that small M "may result in hidden messages being more easily leaked", and gives no figure.
    """
    groups = by_size(method, found).items()
    return [relation for title, sizes in groups if len(sizes) > 1 for relation in _of_sizes(title, sizes)]


def _of_sizes(title: str, own: Mapping[float, Sequence[Experiment]]) -> list[Relation]:
    small, large = own[min(own)], own[max(own)]
    return [
        Relation(
            f"{title}: M = {min(own):g} leaks more than {max(own):g}, by the best surrogate's gap to the owner's "
            f"decoder, {share:.0%} of the views",
            "difference",
            "more than",
            0.0,
            behind_owner(small, share).minus(behind_owner(large, share)),
            math.nan,
            noise_of(*(best_surrogates(each, share) for each in (small, large))),
        )
        for share in shares(small)
        if share > 0
    ]
