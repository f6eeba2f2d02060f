"""Table 1, the appendix's other metrics, and messages on legal views and covered pixels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from stages.analysis.method_titles import GS_HIDER, OURS
from stages.analysis.page.figures import MISSING, label
from stages.analysis.page.summary import Tile
from stages.analysis.page.tables import PICTURE_QUANTITIES
from stages.analysis.paper.chapter import (
    LPIPS,
    PICTURES,
    VIEWS,
    Chapter,
    blocks,
    noise_note,
    noises,
    of_method,
    title_of,
    usual,
)
from stages.analysis.paper.fidelity_relations import own_relations, paper_relations
from stages.analysis.paper.grid import (
    AVERAGE,
    DIFFERENCE,
    HERE,
    PAPER,
    Cell,
    Grid,
    Line,
    headings,
    measured_cells,
    published_cells,
    signed,
    size_cell,
    without_empty_columns,
)
from stages.analysis.paper.measuring import (
    Figure,
    Spread,
    cover,
    measure,
    message,
    published_bytes,
    size,
    total_bytes,
)
from stages.analysis.paper.message_tables import CAPTION, Shown, messages_grid
from stages.analysis.paper.published import Published, Subject, average, row_of
from stages.analysis.paper.runs import Run, Study, capture_title
from stages.analysis.probes import probed
from stages.hiding.method_names import PLAIN


def fidelity(study: Study, tables: Published) -> Chapter:
    """The chapter on one scene hidden in another, with every method."""
    runs = usual(study.select(lambda run: run.method == PLAIN or hides_one_scene(run)))
    grids = [_grid(quantity, "test", runs, study, tables) for quantity in PICTURE_QUANTITIES]
    shown = [Shown((title,), group) for _, title, group in blocks(runs)]
    grids.append(messages_grid(f"Messages: {CAPTION}", ("Method",), shown))
    grids.append(_grid("psnr", "train", runs, study, None))
    return Chapter(
        "One scene hidden in another",
        tuple(grid for grid in grids if any(not line.published for line in grid.lines)),
        (*paper_relations(runs, study, tables), *own_relations(runs, study, tables)),
        runs,
        _tiles(runs, tables),
    )


def hides_one_scene(run: Run) -> bool:
    """Whether the run hides one scene, as in the paper's first experiment, and is no probe of a decoder."""
    return len(run.messages) == 1 and not run.hides_image and probed(run.method) is None


def size_note(runs: Sequence[Run]) -> str:
    """What the sizes include."""
    included = "everything that is stored, including both decoders"
    if any(math.isnan(total_bytes(run)) and not math.isnan(published_bytes(run)) for run in runs):
        included = "what is published, without the message decoder"
    return (
        f"Size: {included}, as arrays. PLY files of 3DGS, 3DGS+SH and 3DGS+Decoder, and those of GS-Hider's "
        "released code, have 12 bytes a Gaussian more, three normals of zero."
    )


def _grid(quantity: str, split: str, runs: Sequence[Run], study: Study, tables: Published | None) -> Grid:
    """Cover and message of each method by capture; the paper's rows below ours, if `tables` is given."""
    captures = study.captures
    reference = of_method(runs, PLAIN, cover(quantity, split))
    scene = quantity == "psnr" and split == "test"
    figures: tuple[tuple[Subject, Figure], ...] = (
        ("cover", cover(quantity, split)),
        ("message", message(quantity, split)),
    )
    others = _other_messages(runs, captures, tables) if tables is not None else {}
    lines: list[Line] = []
    for method, title, group in blocks(runs, tables.fidelity if tables else ()):
        for subject, figure in figures:
            compared = reference if subject == "cover" and method != PLAIN else None
            expected = quantity in LPIPS and any(subject == "cover" or run.messages for run in group)
            cells = measured_cells(quantity, measure(group, figure), compared, captures, expected)
            lead = _scene_cells(group, captures, subject == "cover") if scene else []
            lines.append(Line((title, PICTURES[subject], HERE), (*lead, *cells)))
            if tables is not None and title == title_of(method):
                foreign = others if subject == "message" else {}
                lines.append(_published_line(quantity, method, subject, captures, tables, scene, foreign))
    notes = [size_note(runs)] if scene else []
    if scene:
        notes += _notes_on_messages(others)
    if split == "test" and any(measure(runs, figure).by_capture for _, figure in figures):
        notes.append(noise_note(noises(runs, study, quantity), quantity, " dB" if quantity == "psnr" else ""))
    return without_empty_columns(
        Grid(
            f"{label(quantity)}, {VIEWS[split]}",
            ("Method", "Picture", "Figures"),
            (*(("Size (MB)", "Gaussians") if scene else ()), *headings(captures)),
            tuple(lines),
            tuple(notes),
        )
    )


def _scene_cells(group: Sequence[Run], captures: Sequence[str], shown: bool) -> list[Cell]:
    """The average size and number of Gaussians, or empty cells unless `shown`; a note says if captures lack them."""
    if not shown:
        return [Cell(""), Cell("")]
    figures: tuple[tuple[str, Figure], ...] = (("container_bytes", size), ("gaussians", cover("gaussians", None)))
    return [size_cell(quantity, measure(group, figure), captures) for quantity, figure in figures]


def _other_messages(runs: Sequence[Run], captures: Sequence[str], tables: Published) -> dict[str, str]:
    """By capture, what the paper hides in it, where our runs hide something else."""
    hidden = {
        capture: {name for run in runs if run.capture == capture for name in _hidden(run)} for capture in captures
    }
    others = {capture: tables.other_message(capture, names) for capture, names in hidden.items() if names}
    return {capture: other for capture, other in others.items() if other is not None}


def _hidden(run: Run) -> tuple[str, ...]:
    """What a run hides: what its item says, else the names by which its messages were scored."""
    return (run.hidden,) if run.hidden else run.messages


def _notes_on_messages(others: Mapping[str, str]) -> list[str]:
    """Why the paper's figures are missing on these captures; empty without any."""
    pairs = " and ".join(f"{other} in {capture_title(capture)}" for capture, other in others.items())
    return [f"The paper hides {pairs}; its message is another picture there and not compared."] if others else []


def _published_line(
    quantity: str,
    method: str,
    subject: Subject,
    captures: Sequence[str],
    tables: Published,
    scene: bool,
    foreign: Mapping[str, str],
) -> Line:
    """The paper's row; captures that are `foreign` have no figure, since the paper's is of another picture."""
    row = row_of(tables, method, subject, quantity)
    reference = row_of(tables, PLAIN, "cover", quantity) if subject == "cover" and method != PLAIN else None
    cells = published_cells(quantity, row, reference, captures, tables)
    cells = [
        Cell(MISSING) if capture in foreign else cell
        for capture, cell in zip((*captures, AVERAGE, DIFFERENCE), cells, strict=True)
    ]
    lead: list[Cell] = []
    if scene:
        megabytes = tables.fidelity[method].megabytes if method in tables.fidelity and subject == "cover" else None
        lead = [Cell(f"{megabytes:.3f}", "", Spread(megabytes)) if megabytes else Cell(""), Cell("")]
    return Line((title_of(method), PICTURES[subject], PAPER), (*lead, *cells), published=True)


def _tiles(runs: Sequence[Run], tables: Published) -> tuple[Tile, ...]:
    """Tiles with the PSNR of cover and message of each hiding method, and with its cover's loss compared with 3DGS."""
    plain = of_method(runs, PLAIN, cover("psnr"))
    tiles = []
    for method in (GS_HIDER, OURS):
        measured = of_method(runs, method, cover("psnr"))
        if not measured.by_capture:
            continue
        lost = signed("psnr", measured.minus(plain).average.mean)
        note = [f"{lost} dB vs. 3DGS"] if lost else []
        if method in tables.fidelity:
            difference = average(tables.fidelity[method].cover) - average(tables.fidelity[PLAIN].cover)
            note.append(f"the paper {signed('psnr', difference)}")
        tiles.append(Tile(f"{title_of(method)}, cover", f"{measured.average.mean:.2f} dB", "; ".join(note)))
        hidden = of_method(runs, method, message("psnr"))
        if hidden.by_capture:
            tiles.append(
                Tile(f"{title_of(method)}, message", f"{hidden.average.mean:.2f} dB", "whole pictures, test views")
            )
    return tuple(tiles)
