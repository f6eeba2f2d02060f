"""Where the figures of a page come from: the artifacts it was made from, each with the digest that finds it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from stages.analysis.paper.grid import Grid, Line
from stages.analysis.paper.runs import Study

DIGITS = 12
"""Number of digits of a digest that are shown, as in the engine's own messages."""

HOW_TO_LOOK = (
    "`python -m pipeline show DIGEST --all`, with digits from here in place of DIGEST, shows everything that was "
    "measured and how it was made, in the store that holds it."
)
HOW_THE_OWNER_LOOKS = (
    f"Items are named as in the run that made this page. {HOW_TO_LOOK.replace('--all', '--all --reveal')}"
)


def sources_grid(names: Sequence[str], rows: Iterable[Sequence[str]], note: str) -> Grid | None:
    """A line for each row; its values, the last a digest, are named by `names` and "Artifact". None without rows."""
    lines = dict.fromkeys((*row[:-1], row[-1][:DIGITS]) for row in rows)
    if not lines:
        return None
    return Grid(
        "What this page was made from", (*names, "Artifact"), (), tuple(Line(line, ()) for line in lines), (note,)
    )


def owner_sources(study: Study) -> Grid | None:
    """Every artifact that the study was read from, by its name in the workflow."""
    return sources_grid(("Item",), study.sources, HOW_THE_OWNER_LOOKS)
