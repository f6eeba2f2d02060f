"""What is not secure, container by container, in words made from the figures."""

from __future__ import annotations

import math
from collections.abc import Sequence

from stages.analysis.paper.runs import Experiment
from stages.analysis.paper.secrecy_figures import Found, Kind, figure, shares
from stages.analysis.secrecy.conditions import OPEN, OWNER, SURROGATE


def words_on(found: Found) -> list[str]:
    """A sentence for each kind of container that is not secure."""
    return [sentence for kind, experiments in found.items() if (sentence := _sentence(kind, experiments))]


def _sentence(kind: Kind, experiments: Sequence[Experiment]) -> str:
    owner, floor = (figure(experiments, name, OWNER).mean for name in ("psnr_covered", "psnr_constant"))
    opened = figure(experiments, "psnr_covered", OPEN)
    if opened.count:
        return f"{kind.title} keeps nothing secret: the published file alone shows the message at {opened.mean:.2f} dB."
    parts = []
    for share in (each for each in shares(experiments) if each > 0):
        shown = figure(experiments, "psnr_covered", SURROGATE, share).mean
        related, others = (
            figure(experiments, name, SURROGATE, share).mean for name in ("correlation", "correlation_others")
        )
        part = (shown - floor) / (owner - floor) if owner > floor else math.nan
        parts.append(
            f"{share:.0%} of the views {max(part, 0.0):.0%} of the way (r = {related:.2f}, control {others:.2f})"
        )
    if not parts:
        return ""
    return (
        f"{kind.title} is not secure against whoever has views of the message: from one colour to the owner's decoder, "
        f"a surrogate goes with {'; with '.join(parts)}."
    )
