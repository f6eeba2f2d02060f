"""The public version of the same runs: scenes compared with their photos, in words that fit any splatted scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stages.analysis.page.figures import label
from stages.analysis.page.material import is_public, neutral_titles
from stages.analysis.page.tables import PICTURE_QUANTITIES
from stages.analysis.paper.chapter import Chapter
from stages.analysis.paper.grid import Grid, Line, headings, measured_cells, without_empty_columns
from stages.analysis.paper.measuring import Measured, cover, measure
from stages.analysis.paper.runs import Run, Study, capture_title
from stages.analysis.paper.sources import HOW_TO_LOOK, sources_grid
from stages.hiding.method_names import PLAIN


def public_study(study: Study, names_captures: bool) -> Study:
    """Only rows that anyone could measure; captures are numbered unless their names may be published."""
    numbers = {capture: str(number) for number, capture in enumerate(study.captures, start=1)}

    def public(runs: Sequence[Run]) -> tuple[Run, ...]:
        return tuple(
            replace(
                run,
                capture=run.capture if names_captures else numbers[run.capture],
                rows=tuple(row for row in run.rows if is_public(row)),
            )
            for run in runs
        )

    return Study(public(study.runs), public(study.timings))


def public_chapter(study: Study, private: Study) -> Chapter:
    """Each kind of run as a numbered scene, beside plain 3DGS.

    Only the `private` study knows what was hidden, and so which runs are of one kind; nothing else is taken from it.
    """
    lines = [
        Line((title, label(quantity)), tuple(measured_cells(quantity, measured, None, study.captures)))
        for title, group in _scenes(study, private).items()
        for quantity, measured in _figures(group, study).items()
    ]
    if not lines:
        return Chapter("Scenes", ())
    grid = Grid("Test views", ("Scene", "Metric"), headings(study.captures), tuple(lines))
    return Chapter("Scenes", (without_empty_columns(grid),))


def public_sources(study: Study, private: Study) -> Grid | None:
    """The artifacts behind `public_chapter`, under its titles: names in the workflow may reveal a message."""
    rows = [
        (title, capture_title(run.capture), run.digest)
        for title, group in _scenes(study, private).items()
        for run in (*group, *_timed(group, study))
    ]
    return sources_grid(("Scene", "Capture"), rows, HOW_TO_LOOK)


def _scenes(study: Study, private: Study) -> dict[str, list[Run]]:
    """The runs of each scene, by its title, with plain 3DGS first."""
    kinds = {(run.method, run.stage): run.kind for run in private.runs}
    groups: dict[str, list[Run]] = {}
    for run in study.runs:
        name = str(kinds.get((run.method, run.stage), run.kind))
        groups.setdefault(PLAIN if run.method == PLAIN and not run.settings else name, []).append(run)
    titles = neutral_titles(groups)
    return {titles[name]: groups[name] for name in sorted(groups, key=lambda name: name != PLAIN)}


def _figures(group: Sequence[Run], study: Study) -> dict[str, Measured]:
    """Every quantity of a scene, by its name."""
    return {
        **{quantity: measure(group, cover(quantity)) for quantity in PICTURE_QUANTITIES},
        **{quantity: measure(group, cover(quantity, None)) for quantity in ("container_bytes", "gaussians")},
        "seconds_per_frame": measure(_timed(group, study), cover("seconds_per_frame", None)),
    }


def _timed(group: Sequence[Run], study: Study) -> list[Run]:
    """The timings of a scene; none if another scene has the same method and settings."""
    alike = [run for run in study.runs if run.kind == group[0].kind]
    return [run for run in study.timings if run.kind == group[0].kind and len(alike) == len(group)]
