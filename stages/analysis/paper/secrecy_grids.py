"""The tables of secrecy: decoders that are not the owner's, attackers with some views, and the feature map as it is."""

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
from stages.analysis.paper.measuring import Spread
from stages.analysis.paper.runs import Experiment
from stages.analysis.paper.secrecy_figures import (
    Found,
    all_of,
    all_shares,
    best_blind,
    captures_of,
    figure,
    mean_over,
    rows_of,
)
from stages.analysis.paper.secrecy_words import words_on
from stages.analysis.secrecy.conditions import (
    ALL,
    BLIND,
    CHANNELS,
    COMPONENTS,
    COVER_ITSELF,
    LINEAR,
    LINES,
    OPEN,
    OWNER,
    SURROGATE,
    VIEWS_SEEN,
    WRONG,
)

CORRELATION = "residual_correlation"
"""As which quantity a correlation is written."""


def wrong_grid(found: Found) -> Grid:
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
                        figure_cell("psnr", Spread(_best(experiments, reader))),
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
        ("PSNR (dB)", "To one colour", "Best of them", "Correlation", "With other views"),
        tuple(lines),
        (
            "± is over decoders. Correlation: of luminances, without sign, with the message of that view; beside it, "
            "as the control, with the message of the other test views. A decoder that shows the message in negative "
            "has a low PSNR and a high correlation. The paper shows what one random decoder makes of it, and "
            'finds it "completely unable to reconstruct the hidden scene"; it gives no figure.',
            "That a random decoder shows nothing says little: it shows nothing of any picture. The surrogates below "
            "say how much the secret is worth.",
        ),
    )


def _best(experiments: Sequence[Experiment], reader: str) -> float:
    """Of the decoder that shows most."""
    rows = rows_of(experiments, "psnr_covered", reader)
    means = [mean_over([row for row in rows if row.seed == seed]) for seed in {row.seed for row in rows}]
    return max(means) if len(means) > 1 else math.nan


def surrogate_grid(found: Found) -> Grid:
    every = [share for share in all_shares(found) if share > 0]
    lines = []
    for kind, experiments in found.items():
        owner = _reading_cell(experiments, OWNER, None)
        floor = figure_cell("psnr", Spread(figure(experiments, "psnr_constant", OWNER).mean))
        blind = best_blind(experiments)
        opened = figure(experiments, "psnr_covered", OPEN).count
        nothing = OPEN if opened else blind
        for condition, words in ((SURROGATE, "decoder, trained"), (LINEAR, "least squares")):
            seen = tuple(_reading_cell(experiments, condition, share) for share in every)
            if condition == SURROGATE or any(cell.text for cell in seen):
                first = _reading_cell(experiments, nothing, None) if nothing and condition == SURROGATE else Cell("")
                lines.append(Line((kind.title, words), (first, *seen, owner, floor)))
    headings = tuple(_share_heading(share, found) for share in every)
    return without_empty_columns(
        Grid(
            f"Attackers with some of the message's views, {captures_of(all_of(found))}, test views: the message (dB)",
            ("Container", "Surrogate"),
            ("0 %", *headings, "Owner", "One colour"),
            tuple(lines),
            (
                "In brackets: the correlation with the message. ± is over the views that leaked and first weights. At "
                "0 % nobody has a picture: what stands there is the best of several ways to look at three channels of "
                "the feature map, given the true colours afterwards (an affine map, twelve numbers), so that it is the "
                "most that could be made out; of 3DGS+SH, what anyone renders from the published attributes. The paper "
                "gives no figures.",
                *words_on(found),
            ),
        )
    )


def _reading_cell(experiments: Sequence[Experiment], condition: str, share: float | None) -> Cell:
    spread = figure(experiments, "psnr_covered", condition, share)
    if not spread.count:
        return Cell("")
    related = figure(experiments, "correlation", condition, share).mean
    written = figure_cell("psnr", spread)
    return Cell(written.text, f"r = {related:.2f}", written.spread)


def _share_heading(share: float, found: Found) -> str:
    counts = sorted(
        {round(row.value) for each in found.values() for row in rows_of(each, VIEWS_SEEN, SURROGATE, share)}
    )
    words = " or ".join(map(str, counts))
    return f"{share:.0%}, {words} view{'s' if counts != [1] else ''}"


def feature_map_grid(found: Found) -> Grid:
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
        for condition, words in _blind_lines(experiments):
            shown = figure(experiments, "correlation", condition)
            others = figure(experiments, "correlation_others", condition)
            lines.append(
                Line(
                    (kind.title, words),
                    (
                        Cell(""),
                        figure_cell(CORRELATION, Spread(shown.mean)),
                        figure_cell(CORRELATION, Spread(others.mean)),
                    )
                    + (figure_cell(CORRELATION, Spread(_clean(experiments, condition))),)
                    + (Cell(""),) * 4,
                )
            )
    columns = ("Cover", "Message", "Other views' message", "Nothing hidden")
    return without_empty_columns(
        Grid(
            f"What the feature map shows as it is, {captures_of(all_of(found))}, test views: correlations without sign",
            ("Container", "Channels"),
            (*columns, *(f"{name}, edges" for name in columns)),
            tuple(lines),
            (
                f"Of luminances, and of the lengths of their gradients; of {CHANNELS}, {COMPONENTS} and {ALL} the "
                "multiple correlation: that with the best linear prediction. Other views' message: the control that "
                "tells a trace of this view's message from what all its views have in common. Nothing hidden: the same "
                "channels of a container of the same method, cover and seed without a message, with the "
                "message's pictures: what chance comes to. Blind readings have the true colours, which adds to it.",
                'The paper shows three channels and finds "no traces of the hidden information"; it gives no figure.',
            ),
        )
    )


def _blind_lines(experiments: Sequence[Experiment]) -> list[tuple[str, str]]:
    prefix = BLIND.format("")
    conditions = dict.fromkeys(row.condition for each in experiments for row in each.rows)
    return [
        (condition, f"blind: {condition.removeprefix(prefix)}")
        for condition in conditions
        if condition.startswith(prefix) and not condition.endswith("nothing hidden")
    ]


def _clean(experiments: Sequence[Experiment], condition: str) -> float:
    if condition == BLIND.format(COVER_ITSELF):
        return math.nan
    return figure(experiments, "correlation", f"{condition}, nothing hidden").mean
