"""Whether each training is long enough: what the same with more iterations gains."""

from __future__ import annotations

from collections.abc import Sequence

from stages.analysis.page.material import GS_HIDER, OURS, PLAIN
from stages.analysis.paper.chapter import PICTURES, Base, Chapter, base_settings, noise_note, noises, title_of
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
    base = base_settings(study, tables)
    chosen = study.select(lambda run: (run.method == PLAIN or hides_one_scene(run)) and _is_usual(run, base))
    long = {run.method for run in chosen if _iterations(run) != base.get("iterations")}
    runs = tuple(run for run in chosen if run.method in long)
    lines: list[Line] = []
    for method in dict.fromkeys(run.method for run in runs):
        own = [run for run in runs if run.method == method]
        usual = [run for run in own if _iterations(run) == base.get("iterations")]
        for subject, figure in FIGURES.items():
            for count in sorted({_iterations(run) for run in own}, key=str):
                again = [run for run in own if _iterations(run) == count]
                reference = measure(usual, figure) if again != usual else None
                cells = measured_cells("psnr", measure(again, figure), reference, study.captures)
                lines.append(Line((title_of(method), PICTURES[subject], _written(count), HERE), tuple(cells)))
    grid = Grid(
        "More iterations, test views: PSNR (dB)",
        ("Method", "Picture", "Iterations", "Figures"),
        (*headings(study.captures)[:-1], "Gained"),
        tuple(lines),
        (noise_note(noises(runs, study)),),
    )
    return Chapter("At the plateau", (without_empty_columns(grid),), _relations(runs, study, base), runs)


def _relations(runs: Sequence[Run], study: Study, base: Base) -> tuple[Relation, ...]:
    usual = base.get("iterations")
    if not isinstance(usual, float):
        return ()
    spreads, found = noises(runs, study), []
    for method, most in MOST_GAINED.items():
        own = [run for run in runs if run.method == method]
        for subject, figure in FIGURES.items():
            if method == PLAIN and subject == "message":
                continue
            twice = measure((run for run in own if _iterations(run) == 2 * usual), figure)
            once = measure((run for run in own if _iterations(run) == usual), figure)
            text = f"{title_of(method)}: what twice the iterations gain on the {subject}"
            gained = twice.minus(once)
            found.append(Relation(text, "difference", "less than", most, gained, noise=spreads[subject].deviation))
    return tuple(found)


def _is_usual(run: Run, base: Base) -> bool:
    return all(value == base[name] for name, value in run.settings if name != "iterations")


def _iterations(run: Run) -> float | str | None:
    return dict(run.settings).get("iterations")


def _written(count: float | str | None) -> str:
    return f"{count:,.0f}" if isinstance(count, float) else str(count or "")
