"""Is each training long enough? What more iterations gain."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from stages.analysis.method_titles import GS_HIDER, OURS
from stages.analysis.paper.ablations import varied
from stages.analysis.paper.chapter import PICTURES, Chapter, noise_note, noises, title_of
from stages.analysis.paper.fidelity import hides_one_scene
from stages.analysis.paper.fidelity_relations import own_relations
from stages.analysis.paper.grid import HERE, Grid, Line, headings, measured_cells, without_empty_columns
from stages.analysis.paper.measuring import Figure, cover, measure, message
from stages.analysis.paper.published import Published, Subject
from stages.analysis.paper.relations import Relation
from stages.analysis.paper.runs import Run, Study
from stages.hiding.method_names import PLAIN

FIGURES: dict[Subject, Figure] = {"cover": cover("psnr"), "message": message("psnr")}
MOST_GAINED = {PLAIN: 0.3, GS_HIDER: 0.1, OURS: 0.1}
"""Upper bounds on the gain by each doubling of the iterations, in dB."""


def plateau(study: Study, tables: Published) -> Chapter:
    """The chapter of methods that were trained for several numbers of iterations."""
    chosen = varied(study.select(lambda run: run.method == PLAIN or hides_one_scene(run)), "iterations")
    longer = {run.method for run in chosen if run.settings}
    runs = tuple(run for run in chosen if run.method in longer)
    lines: list[Line] = []
    for method in dict.fromkeys(run.method for run in runs):
        by_count = _by_count((run for run in runs if run.method == method), study)
        for subject, figure in FIGURES.items():
            once = measure(by_count.get(study.iterations or 0, ()), figure)
            for count, group in by_count.items():
                again = measure(group, figure)
                cells = measured_cells("psnr", again, once if count != study.iterations else None, study.captures)
                lines.append(Line((title_of(method), PICTURES[subject], f"{count:,.0f}", HERE), tuple(cells)))
    grid = Grid(
        "More iterations, test views: PSNR (dB)",
        ("Method", "Picture", "Iterations", "Figures"),
        (*headings(study.captures)[:-1], "vs. fewest iterations"),
        tuple(lines),
        (noise_note(noises(runs, study)),),
    )
    relations = (*_gains(runs, study), *_beyond(runs, study, tables))
    return Chapter("At the plateau", (without_empty_columns(grid),), relations, runs)


def _gains(runs: Sequence[Run], study: Study) -> Iterator[Relation]:
    """What each doubling of the iterations gains."""
    spreads = noises(runs, study)
    for method, most in MOST_GAINED.items():
        by_count = _by_count((run for run in runs if run.method == method), study)
        for subject, figure in FIGURES.items():
            if method == PLAIN and subject == "message":
                continue
            for count, once in by_count.items():
                if 2 * count in by_count:
                    gained = measure(by_count[2 * count], figure).minus(measure(once, figure))
                    more = f"gain of {2 * count:,.0f} iterations over {count:,.0f}"
                    text = f"{title_of(method)}: {more} on the {subject}"
                    yield Relation(text, "difference", "less than", most, gained, noise=spreads[subject])


def _beyond(runs: Sequence[Run], study: Study, tables: Published) -> Iterator[Relation]:
    """Our method compared with GS-Hider wherever both were trained for more than the usual iterations."""
    for count, group in _by_count(runs, study).items():
        if count > (study.iterations or 0) and {OURS, GS_HIDER} <= {run.method for run in group}:
            for relation in own_relations(group, study, tables):
                yield replace(relation, text=f"{relation.text}, after {count:,.0f} iterations")


def _by_count(runs: Iterable[Run], study: Study) -> dict[float, list[Run]]:
    """Runs by their number of iterations, ascending."""
    groups: dict[float, list[Run]] = {}
    for run in sorted(runs, key=lambda run: _iterations(run, study)):
        groups.setdefault(_iterations(run, study), []).append(run)
    return groups


def _iterations(run: Run, study: Study) -> float:
    """The number of iterations of a run; the usual one if it states none."""
    value = dict(run.settings).get("iterations", study.iterations)
    return value if isinstance(value, float) else 0.0
