"""Secrecy of the message: wrong decoders, surrogates, and the feature map as it is."""

from __future__ import annotations

from stages.analysis.page.chart import Chart, Series, line_chart
from stages.analysis.paper.chapter import Chapter
from stages.analysis.paper.published import Published
from stages.analysis.paper.runs import Study
from stages.analysis.paper.secrecy_figures import (
    Found,
    all_shares,
    behind_owner,
    best_blind,
    best_surrogates,
    by_size,
    figure,
    kinds,
    shares,
)
from stages.analysis.paper.secrecy_grids import feature_map_grid, surrogate_grid, wrong_grid
from stages.analysis.paper.secrecy_relations import secrecy_relations
from stages.analysis.secrecy.conditions import OPEN


def secrecy(study: Study, tables: Published) -> Chapter:
    """The chapter on `probe_secrecy`: containers of one method and M share a line, over captures and seeds."""
    found = kinds(study)
    if not found:
        return Chapter("Secrecy of the message", ())
    grids = (wrong_grid(found), surrogate_grid(found), feature_map_grid(found))
    charts = (
        _chart("The message as the best surrogate shows it", "psnr_covered", "PSNR over its pixels (dB)", found),
        _chart("The same in true colours", "psnr_coloured", "PSNR over its pixels (dB)", found),
        _chart("Correlation with the message", "correlation", "Multiple correlation", found),
        *(_size_chart(share, found) for share in all_shares(found) if share > 0),
    )
    return Chapter(
        "Secrecy of the message",
        grids,
        tuple(secrecy_relations(found)),
        charts=tuple(chart for chart in charts if chart is not None),
    )


def _chart(title: str, quantity: str, upward: str, found: Found) -> Chart | None:
    """A line for each kind of container, over the share of leaked views: the surrogate that shows most with so many.

    At share 0 it begins with public attributes, or with the best blind reading if `quantity` is in true colours.
    """
    series = []
    for kind, experiments in found.items():
        if figure(experiments, quantity, OPEN).count:
            points = [(100 * share, figure(experiments, quantity, OPEN).mean) for share in all_shares(found)]
        else:
            blind = best_blind(experiments) if quantity != "psnr_covered" else None
            points = [(0.0, figure(experiments, quantity, blind).mean)] if blind else []
            points += [
                (100 * share, best_surrogates(experiments, share, quantity).average.mean)
                for share in shares(experiments)
                if share > 0
            ]
        series.append(Series(kind.title, tuple(points)))
    return line_chart(title, series, axes=("Share of the training views that leaked (%)", upward))


def _size_chart(share: float, found: Found) -> Chart | None:
    """The best surrogate's PSNR minus that of the owner's decoder, over M; None if M does not vary."""
    series = []
    for method in dict.fromkeys(kind.method for kind in found):
        for name, sizes in by_size(method, found).items():
            points = tuple((size, behind_owner(each, share).average.mean) for size, each in sizes.items())
            if len(points) > 1:
                series.append(Series(name, points))
    title = f"Does small M leak more? The best surrogate with {share:.0%} of the views"
    return line_chart(title, series, axes=("M", "dB vs. the owner's decoder")) if series else None
