"""The tables of secrecy: wrong decoders, attackers with some views, and the feature map as it is."""

from __future__ import annotations

import math
from collections.abc import Sequence

from stages.analysis.paper.grid import (
    HERE,
    PAPER,
    Cell,
    Grid,
    Line,
    difference_cell,
    figure_cell,
    without_empty_columns,
)
from stages.analysis.paper.measuring import UNKNOWN, Spread
from stages.analysis.paper.runs import Experiment
from stages.analysis.paper.secrecy_figures import (
    Found,
    Kind,
    all_of,
    all_shares,
    best_blind,
    best_decoder,
    blind_conditions,
    captures_of,
    figure,
    rows_of,
)
from stages.analysis.paper.secrecy_words import words_on
from stages.analysis.secrecy.conditions import (
    ALL,
    CHANNELS,
    COMPONENTS,
    COVER_ITSELF,
    LINEAR,
    LINES,
    NOTHING_HIDDEN,
    OPEN,
    OWNER,
    PAINTED,
    SURROGATE,
    VIEWS_SEEN,
    WRONG,
)

CORRELATION = "residual_correlation"
"""The quantity in whose format correlations are written."""


def wrong_grid(found: Found) -> Grid:
    """A line for each reader of each kind of container: the owner's decoder, public attributes, and wrong decoders."""
    lines = []
    for kind, experiments in found.items():
        floor = figure(experiments, "psnr_constant", OWNER).mean
        for reader in (OWNER, OPEN, *WRONG):
            shown = figure(experiments, "psnr_covered", reader)
            if not shown.count:
                continue
            lines.append(
                Line(
                    (kind.title, reader, HERE),
                    (
                        figure_cell("psnr", shown),
                        difference_cell("psnr", shown.mean - floor),
                        figure_cell("psnr", Spread(best_decoder(experiments, reader).average.mean)),
                        figure_cell(CORRELATION, figure(experiments, "correlation", reader)),
                        figure_cell(CORRELATION, Spread(figure(experiments, "correlation_others", reader).mean)),
                    ),
                )
            )
        if figure(experiments, "psnr_covered", WRONG[0]).count:
            lines.append(
                Line((kind.title, WRONG[0], PAPER), (Cell("a picture only"), *(Cell("") for _ in range(4))), True)
            )
    return Grid(
        f"Decoders that are not the owner's, {captures_of(all_of(found))}, test views: the message over its pixels",
        ("Container", "Reader", "Figures"),
        ("PSNR (dB)", "vs. one colour", "Best of them", "Correlation", "With other views"),
        tuple(lines),
        (
            "± is over decoders. Correlation: the multiple correlation of the message's luminance with the three "
            "channels shown; next to it, as the control, the same with the message in the other test views. A decoder "
            "that shows the message as a negative has a low PSNR but a high correlation. The paper shows the output of "
            'one random decoder and finds it "completely unable to reconstruct the hidden scene"; it gives no figure.',
            "That a random decoder shows nothing proves little: it shows nothing of any picture. The surrogates below "
            "show how much the secret is worth.",
        ),
    )


def surrogate_grid(found: Found) -> Grid:
    """A line for each way of reading, a column for each share of leaked views."""
    every = [share for share in all_shares(found) if share > 0]
    lines = [line for kind, experiments in found.items() for line in _surrogate_lines(kind, experiments, every)]
    return without_empty_columns(
        Grid(
            f"Attackers with some of the message's views, {captures_of(all_of(found))}, test views: the message (dB)",
            ("Container", "Surrogate"),
            ("0 %", *(_share_heading(share, found) for share in every), "Owner", "One colour"),
            tuple(lines),
            (
                "PSNR over the message's pixels. ± is over the leaked views and initial weights. In true colours: what "
                "could be made out if someone revealed which colour is which, by an affine map of the reading's three "
                "channels; r is the multiple correlation with the message's luminance, in brackets that with the "
                "message in other views, the control. At 0 % the attacker has no picture: the figure is the best of "
                "several ways to view three channels of the feature map; for 3DGS+SH, what anyone can render from the "
                "published attributes. In true colours, the column for one colour has the cover itself. The paper "
                "gives no figures.",
                "Painted onto Gaussians: colours of the Gaussians that the cover hardly shows are fitted to the leaked "
                "views, as is the share of each that is the message's; nothing stored in their features is read.",
                "Surrogates learn more with more steps: these figures are for a few minutes on one core.",
                *words_on(found),
            ),
        )
    )


def _surrogate_lines(kind: Kind, experiments: Sequence[Experiment], every: Sequence[float]) -> list[Line]:
    opened = figure(experiments, "psnr_covered", OPEN).count > 0
    nobody = OPEN if opened else best_blind(experiments)
    floors = {
        False: figure_cell("psnr", Spread(figure(experiments, "psnr_constant", OWNER).mean)),
        True: figure_cell("psnr", Spread(figure(experiments, "psnr_coloured", COVER_ITSELF).mean), "the cover"),
    }
    lines = []
    for words, quantity, condition in (
        ("decoder, trained", "psnr_covered", SURROGATE),
        ("decoder, trained, in true colours", "psnr_coloured", SURROGATE),
        ("least squares", "psnr_covered", LINEAR),
        ("painted onto Gaussians", "psnr_covered", PAINTED),
        ("painted onto Gaussians, in true colours", "psnr_coloured", PAINTED),
    ):
        coloured = quantity == "psnr_coloured"
        at_nothing = nobody if coloured or (opened and condition == SURROGATE) else None
        readings = [(at_nothing, None), *((condition, share) for share in every), (OWNER, None)]
        cells = [_reading_cell(experiments, quantity, *reading, related=coloured) for reading in readings]
        measured = condition != PAINTED or any(cell.text for cell in cells[1:-1])
        if measured and any(cell.text for cell in cells[:-1]):
            lines.append(Line((kind.title, words), (*cells, floors[coloured])))
    return lines


def _reading_cell(
    experiments: Sequence[Experiment], quantity: str, condition: str | None, share: float | None, related: bool
) -> Cell:
    spread = figure(experiments, quantity, condition, share) if condition else UNKNOWN
    if not spread.count:
        return Cell("")
    written = figure_cell("psnr", spread)
    if not related:
        return Cell(written.text, "", written.spread)
    own, others = (
        figure(experiments, name, str(condition), share).mean for name in ("correlation", "correlation_others")
    )
    return Cell(written.text, f"r = {own:.2f} ({others:.2f})", written.spread)


def _share_heading(share: float, found: Found) -> str:
    counts = sorted(
        {round(row.value) for each in found.values() for row in rows_of(each, VIEWS_SEEN, SURROGATE, share)}
    )
    words = " or ".join(map(str, counts))
    return f"{share:.0%}, {words} view{'s' if counts != [1] else ''}"


def feature_map_grid(found: Found) -> Grid:
    """A line for each reading of the feature map: its correlations with cover, message, and controls."""
    lines = []
    for kind, experiments in found.items():
        for line in LINES:
            cells = [
                figure_cell(CORRELATION, Spread(figure(experiments, name, line).mean))
                for name in (
                    *("correlation_cover", "correlation", "correlation_others", "correlation_clean"),
                    *("edges_cover", "edges", "edges_others", "edges_clean"),
                )
            ]
            if not math.isnan(cells[0].spread.mean):
                lines.append(Line((kind.title, line), tuple(cells)))
        lines += [_blind_line(kind, experiments, condition) for condition in blind_conditions(experiments)]
    columns = ("Cover", "Message", "Other views' message", "Nothing hidden")
    return without_empty_columns(
        Grid(
            f"What the feature map shows as it is, {captures_of(all_of(found))}, test views: absolute correlations",
            ("Container", "Channels"),
            (*columns, *(f"{name}, edges" for name in columns)),
            tuple(lines),
            (
                f"Between luminances and, for edges, the lengths of their gradients; for {CHANNELS}, {COMPONENTS} and "
                f"{ALL}, the multiple correlation: that with the best linear prediction. Other views' message: the "
                "control that distinguishes a trace of this view's message from what all its views have in common. "
                "Nothing hidden: the same channels of a container of the same method, cover and seed without a "
                "message, correlated with the message's pictures: the level of chance. Blind readings, too, have the "
                "multiple correlation.",
                'The paper shows three channels and finds "no traces of the hidden information"; it gives no figure.',
            ),
        )
    )


def _blind_line(kind: Kind, experiments: Sequence[Experiment], condition: str) -> Line:
    figures = (
        math.nan,
        figure(experiments, "correlation", condition).mean,
        figure(experiments, "correlation_others", condition).mean,
        figure(experiments, "correlation", NOTHING_HIDDEN.format(condition)).mean,
    )
    cells = tuple(figure_cell(CORRELATION, Spread(value)) for value in figures)
    return Line((kind.title, condition), cells + (Cell(""),) * 4)
