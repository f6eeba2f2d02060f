"""View-weight pruning beside GSPure's figures, and the effect of a floor under messages on gains."""

from __future__ import annotations

from collections.abc import Iterator

from stages.analysis.attacks.catalogue import AttackName
from stages.analysis.paper.attacked import Attacked
from stages.analysis.paper.chapter import title_of
from stages.analysis.paper.grid import HERE, Cell, Grid, Line, average_cell
from stages.analysis.paper.measuring import Spread
from stages.analysis.paper.published import Published
from stages.analysis.paper.runs import capture_title

VIEW_WEIGHTS: tuple[AttackName, AttackName] = ("view_weight_pruning", "view_weight_clustering")

GSPURE = "GSPure"
"""Marks the lines of that paper's figures."""

NOT_REPRODUCED = (
    "GSPure (AAAI 2026) itself was not reproduced. Only its idea is used: Gaussians are clustered by their weight in "
    "views, and clusters that serve the message are pruned. The weights, the clusters and their order are our own, as "
    "are captures and picture sizes: how GSPure would perform here is not known. Lower is better for the owner."
)


def purification(attacked: Attacked, tables: Published) -> Grid:
    """Gains of both attacks, with and without the floor, and the largest gain that the floor allows."""
    ours = []
    for method in attacked.by_method:
        floored, raw = (
            [attacked.gain(method, attack, "as found", is_floored) for attack in VIEW_WEIGHTS]
            for is_floored in (True, False)
        )
        if any(figure.by_capture for figure in floored):
            figures = (*floored, attacked.most_to_lose(method), *raw)
            cells = tuple(average_cell("psnr", figure, attacked.captures) for figure in figures)
            ours.append(Line((title_of(method), HERE), cells))
    theirs = [
        Line((name, GSPURE), (*[Cell("")] * 4, Cell(f"{value:.2f}", "", Spread(value))), published=True)
        for name, value in tables.purification.items()
    ]
    return Grid(
        "View-weight pruning: the message's loss minus the cover's (dB)",
        ("Method", "Figures"),
        ("One by one", "By clusters", "Most it can lose", "One by one, no floor", "By clusters, no floor"),
        (*ours, *theirs) if ours else (),
        (
            NOT_REPRODUCED,
            *floor_notes(attacked),
            "No floor: messages count as read, however much worse than a single-colour picture. GSPure's figures, for "
            "which no floor is known, are shown with these.",
        ),
    )


def floor_notes(attacked: Attacked) -> Iterator[str]:
    """Why gains are bounded, and which methods have nothing to lose at first; none if floors were not measured."""
    if any(attacked.most_to_lose(method).by_capture for method in attacked.by_method):
        yield (
            "A message that reads worse than the best single-colour picture counts as that picture: no gain exceeds "
            "the message's initial lead over it, the most it can lose."
        )
    for method in attacked.by_method:
        most = attacked.most_to_lose(method).by_capture
        bare = [capture_title(capture) for capture, spread in most.items() if spread.mean <= 0]
        if bare:
            yield (
                f"{title_of(method)} shows no more than one colour on {', '.join(bare)} even before any attack: it has "
                "nothing to lose there, which lowers its averages."
            )
