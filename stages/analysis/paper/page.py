"""The page as the HTML template and the Markdown file take it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from stages.analysis.method_titles import METHOD_TITLES
from stages.analysis.page.figures import WORDING
from stages.analysis.page.html import fill, templates_beside
from stages.analysis.page.summary import Tile
from stages.analysis.paper.ablations import ablations
from stages.analysis.paper.chapter import LPIPS, Chapter, Writer
from stages.analysis.paper.fidelity import fidelity
from stages.analysis.paper.frame_time import frame_time
from stages.analysis.paper.grid import Grid
from stages.analysis.paper.no_message import no_message
from stages.analysis.paper.plateau import plateau
from stages.analysis.paper.probes import probes
from stages.analysis.paper.public import public_chapter, public_sources, public_study
from stages.analysis.paper.published import Published, wrong_averages
from stages.analysis.paper.relations import Relation, relations_grid
from stages.analysis.paper.robustness import robustness
from stages.analysis.paper.rtws import rtws
from stages.analysis.paper.runs import Study, capture_title, method_title
from stages.analysis.paper.secrecy import secrecy
from stages.analysis.paper.settings import usual_settings
from stages.analysis.paper.several_messages import several_messages
from stages.analysis.paper.single_image import single_image
from stages.analysis.paper.sources import owner_sources
from stages.analysis.paper.steganalysis import steganalysis
from stages.hiding.method_names import PLAIN
from stages.imaging.lpips_weights import HOW_TO_INSTALL

RESOURCES = ("templates/*",)
TEMPLATES = templates_beside(__file__)
Table = Literal[
    "fidelity",
    "no_message",
    "frame_time",
    "single_image",
    "several_messages",
    "ablations",
    "plateau",
    "probes",
    "steganalysis",
    "secrecy",
    "robustness",
    "rtws",
]
"""Our tables, by which parameters name them."""

WRITERS: Mapping[Table, Writer] = {
    "fidelity": fidelity,
    "no_message": no_message,
    "frame_time": frame_time,
    "single_image": single_image,
    "several_messages": several_messages,
    "probes": probes,
    "rtws": rtws,
    "ablations": ablations,
    "plateau": plateau,
    "steganalysis": steganalysis,
    "secrecy": secrecy,
    "robustness": robustness,
}
PAPER_TITLES = {
    "fidelity": ("Fidelity", "All metrics"),
    "no_message": ("No message",),
    "frame_time": ("Rendering time",),
    "single_image": ("Single image",),
}
"""For each of our tables, the paper's tables that it stands beside, as `published.rows_of` names them."""
DEFINED = ("psnr", "ssim", "lpips_vgg", "lpips_alex", "legal", "psnr_covered", "ssim_covered", "psnr_constant")


@dataclass(frozen=True)
class TablesPage:
    """A page of chapters. What is empty is left out, but an empty chapter says `nothing`.

    `relations` is None if there are none to show; `remarks` are below all tables, `sources` at the end.
    """

    title: str
    summary: str
    tiles: tuple[Tile, ...]
    chapters: tuple[Chapter, ...]
    relations: Grid | None
    remarks: tuple[str, ...]
    definitions: tuple[tuple[str, str], ...]
    command: str
    sources: Grid | None
    nothing: str = "None of this was measured."

    @property
    def grids(self) -> tuple[Grid, ...]:
        """Every table of figures, in order, with the relations last."""
        grids = [grid for chapter in self.chapters for grid in chapter.grids]
        return (*grids, *([self.relations] if self.relations else []))


def owner_page(study: Study, wanted: Sequence[Table], tables: Published, title: str, command: str) -> TablesPage:
    """The `wanted` tables, in this order, beside the paper's, and the relations between their figures."""
    chapters = [WRITERS[name](study, tables) for name in wanted]
    titled = [(chapter.title, relation) for chapter in chapters for relation in chapter.relations]
    captures = ", ".join(map(capture_title, study.captures)) or "no capture"
    return TablesPage(
        f"{title}, compared with the paper",
        f"Measured on {captures}, next to the GS-Hider paper's figures for nine captures of Mip-NeRF 360. "
        f"{_what_differs(study, tables)}{_weights(study, tables)}",
        (
            *_relations_tile(relation for _, relation in titled),
            *(tile for chapter in chapters for tile in chapter.tiles),
        ),
        tuple(chapters),
        relations_grid(titled, study.captures) if titled else None,
        tuple(_remarks(study, chapters, wanted, tables)),
        tuple(WORDING[quantity] for quantity in DEFINED),
        command,
        owner_sources(study),
    )


def public_page(study: Study, private: Study, names_captures: bool) -> TablesPage:
    """Only figures of the scenes; the `private` study serves to tell which runs are of one kind."""
    public = public_study(study, names_captures)
    return TablesPage(
        "Gaussian splatting scenes",
        "Scenes of 3D Gaussians, compared with held-out photos.",
        (),
        (public_chapter(public, private),),
        None,
        (),
        tuple(WORDING[quantity] for quantity in ("psnr", "ssim", "lpips_vgg", "lpips_alex")),
        "",
        public_sources(public, private),
    )


def write_page(page: TablesPage) -> str:
    """The page as self-contained HTML."""
    return fill("tables.html", page, TEMPLATES)


def _what_differs(study: Study, tables: Published) -> str:
    if study.captures and all(map(tables.has, study.captures)):
        return (
            "The captures are called as the paper's. Picture sizes, iterations and where messages lie are the "
            "workflow's: before comparing absolute figures, see that these are the paper's, too."
        )
    return (
        "Captures, picture sizes, iterations and where messages lie differ: compare differences between methods, not "
        "absolute figures."
    )


def _weights(study: Study, tables: Published) -> str:
    """A sentence on λ if the methods shown differ in it, which moves all differences between them; else nothing."""
    shown = {run.method for run in study.runs} | {experiment.method for experiment in study.experiments}
    weights = {
        method: usual_settings(method, tables.setup)["lambda_message"]
        for method in METHOD_TITLES
        if method in shown and method != PLAIN
    }
    if len(set(weights.values())) < 2:
        return ""
    said = ", ".join(f"{weight:g} with {METHOD_TITLES[method]}" for method, weight in weights.items())
    return f" Unless a title or the command says otherwise, messages have a weight λ of {said}: less favours the cover."


def _relations_tile(relations: Iterable[Relation]) -> list[Tile]:
    measured = [relation for relation in relations if relation.measured.by_capture]
    holding = [relation for relation in measured if relation.is_found]
    unsure = sum(relation.within_noise for relation in measured)
    note = f"{unsure} within noise" if unsure else ""
    return [Tile("Relations that hold", f"{len(holding)} of {len(measured)}", note)] if measured else []


def _remarks(study: Study, chapters: Sequence[Chapter], wanted: Sequence[str], tables: Published) -> list[str]:
    remarks = [
        "Second figures under a capture are differences from what the last column names. Average: over the captures "
        "shown; the paper's is over all nine of its own. ±: standard deviation of n runs that differ only in their "
        "seed; for an average, that of the average, with n runs on each capture.",
        "Within noise: so close to the required value that other seeds could well change the verdict. In 95 % of "
        "cases, what is compared lies within this distance of its mean (Student's t, from the standard deviation "
        "between seeds, the number of runs that it is estimated from, and the number of runs compared). The deviation "
        "is pooled over methods, for a table's runs or for all runs, whichever is larger, and assumed to be the same "
        "on captures where no seeds were repeated, which need not be so. Where the tables state no noise, none is "
        "known. For areas under a curve, the deviation follows from their 95 % intervals over views and detectors, "
        "which do not cover how much another training would differ.",
        *(
            f"The paper's average of {name!r} is {average:g}; the mean of its row is {mean:.5g}."
            for name, average, mean in wrong_averages(tables)
            if name.startswith(tuple(title for each in wanted for title in PAPER_TITLES.get(each, ())))
        ),
    ]
    measured = {row.quantity for run in study.runs for row in run.rows if not math.isnan(row.value)}
    lacking = [network for quantity, network in LPIPS.items() if quantity not in measured]
    if "ssim" in measured and lacking:
        networks = " and ".join(lacking)
        remarks.append(
            f"LPIPS ({networks}) was not measured. If the workflow asks for it, weights are missing: {HOW_TO_INSTALL}"
        )
    shown = {run for chapter in chapters for run in chapter.runs}
    left = [run for run in (*study.runs, *study.timings) if run not in shown]
    if left:
        named = dict.fromkeys(f"{capture_title(run.capture)}: {method_title(run)}" for run in left)
        remarks.append(f"Measured, but not in any of these tables: {'; '.join(named)}.")
    return [*remarks, *dict.fromkeys(f"Not made: {label}: {cause}" for label, cause in study.failures)]
