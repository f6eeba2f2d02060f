"""Whether each training is long enough: what the same with more iterations gains."""

from __future__ import annotations

from collections.abc import Sequence

from stages.analysis.page.material import GS_HIDER, OURS, PLAIN
from stages.analysis.paper.ablations import varied
from stages.analysis.paper.chapter import PICTURES, Chapter, noise_note, noises, title_of
from stages.analysis.paper.fidelity import hides_one_scene
from stages.analysis.paper.grid import HERE, Grid, Line, headings, measured_cells, without_empty_columns
from stages.analysis.paper.measuring import Figure, cover, measure, message
from stages.analysis.paper.published import Published, Subject
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study

FIGURES: dict[Subject, Figure] = {"cover": cover("psnr"), "message": message("psnr")}
MOST_GAINED = {PLAIN: 0.3, GS_HIDER: 0.1, OURS: 0.1}
"""By doubling the iterations, in dB."""


def plateau(study: Study, tables: Published) -> Chapter:
    """Methods that were trained for several numbers of iterations."""
    chosen = varied(study.select(lambda run: run.method == PLAIN or hides_one_scene(run)), "iterations")
    longer = {run.method for run in chosen if run.settings}
    runs = tuple(run for run in chosen if run.method in longer)
    lines: list[Line] = []
    for method in dict.fromkeys(run.method for run in runs):
        own = [run for run in runs if run.method == method]
        for subject, figure in FIGURES.items():
            once = measure((run for run in own if not run.settings), figure)
            for count in sorted({_iterations(run, study) for run in own}):
                again = measure((run for run in own if _iterations(run, study) == count), figure)
                cells = measured_cells("psnr", again, once if count != study.iterations else None, study.captures)
                lines.append(Line((title_of(method), PICTURES[subject], f"{count:,.0f}", HERE), tuple(cells)))
    grid = Grid(
        "More iterations, test views: PSNR (dB)",
        ("Method", "Picture", "Iterations", "Figures"),
        (*headings(study.captures)[:-1], "Gained"),
        tuple(lines),
        (noise_note(noises(runs, study)),),
    )
    return Chapter("At the plateau", (without_empty_columns(grid),), _relations(runs, study), runs)


def _relations(runs: Sequence[Run], study: Study) -> tuple[Relation, ...]:
    spreads, found = noises(runs, study), []
    for method, most in MOST_GAINED.items():
        own = [run for run in runs if run.method == method]
        for subject, figure in FIGURES.items():
            if method == PLAIN and subject == "message":
                continue
            once = measure((run for run in own if not run.settings), figure)
            twice = measure((run for run in own if _iterations(run, study) == 2 * (study.iterations or 0)), figure)
            text = f"{title_of(method)}: what twice the iterations gain on the {subject}"
            noise = spreads[subject].deviation
            found.append(Relation(text, "difference", "less than", most, twice.minus(once), noise=noise))
    return tuple(found)


def _iterations(run: Run, study: Study) -> float:
    """How many a run has: the usual ones where it states no other."""
    value = dict(run.settings).get("iterations", study.iterations)
    return value if isinstance(value, float) else 0.0
