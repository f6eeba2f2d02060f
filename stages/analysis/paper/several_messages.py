"""Several scenes hidden in one: what each further one costs. The paper shows pictures of this, but gives no figures."""

from __future__ import annotations

from collections.abc import Sequence

from stages.analysis.page.figures import label
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
    usual,
)
from stages.analysis.paper.grid import (
    HERE,
    Cell,
    Grid,
    Line,
    headings,
    measured_cells,
    size_cell,
    without_empty_columns,
)
from stages.analysis.paper.measuring import cover, measure, message, size
from stages.analysis.paper.message_tables import CAPTION, Shown, messages_grid
from stages.analysis.paper.published import Published
from stages.analysis.paper.runs import Run, Study, by_kind
from stages.hiding.method_names import PLAIN

NOTE = (
    "The paper gives no figures, and does not say whether the messages share its λ. Here each has it, as the only one "
    "would."
)


def several_messages(study: Study, tables: Published) -> Chapter:
    """The chapter of captures that hide one message and more; for each method, the fewest messages first.

    Of several messages, runs of every setting are shown: more channels may serve them better.
    """
    hiding = study.select(lambda run: bool(run.messages) and not run.hides_image)
    many = {run.capture for run in hiding if len(run.messages) > 1}
    plain = study.select(lambda run: run.method == PLAIN)
    every = [run for run in (*hiding, *plain) if run.capture in many]
    as_usual = {id(run) for run in usual(every)}
    shown = [run for run in every if len(run.messages) > 1 or id(run) in as_usual]
    runs = tuple(sorted(shown, key=lambda run: bool(run.settings)))
    kinds = [
        (method, _title(title, alike), alike)
        for method, title, group in blocks(runs)
        for alike in sorted(by_kind(group).values(), key=lambda runs: len(runs[0].messages))
    ]
    grids = [_grid(quantity, "test", kinds, study) for quantity in PICTURE_QUANTITIES]
    grids.append(_messages(kinds))
    grids.append(_grid("psnr", "train", kinds, study))
    return Chapter("Several scenes hidden in one", tuple(grid for grid in grids if grid.lines), (), runs)


Kind = tuple[str, str, Sequence[Run]]
"""A method, the title of its runs with one number of messages, and these runs."""


def _title(title: str, runs: Sequence[Run]) -> str:
    count = len(runs[0].messages)
    return title if not count else f"{title}, {count} message{'s' if count > 1 else ''}"


def _grid(quantity: str, split: str, kinds: Sequence[Kind], study: Study) -> Grid:
    """Cover and messages by capture; the first table also has the size."""
    runs = [run for _, _, group in kinds for run in group]
    scene = (quantity, split) == ("psnr", "test")
    plain = of_method(runs, PLAIN, cover(quantity, split))
    lines: list[Line] = []
    for method, title, group in kinds:
        for number, picture in _pictures(group).items():
            figure = cover(quantity, split) if number is None else message(quantity, split, number=number)
            reference = plain if number is None and method != PLAIN else None
            expected = quantity in LPIPS
            cells = measured_cells(quantity, measure(group, figure), reference, study.captures, expected)
            lines.append(Line((title, picture, HERE), (*_size(group, study.captures, scene, number is None), *cells)))
    notes = [NOTE] if scene else []
    spreads = noises(runs, study, quantity)
    if split == "test" and (scene or any(each.count for each in spreads.values())):
        notes.append(noise_note(spreads, quantity, " dB" if quantity == "psnr" else ""))
    return without_empty_columns(
        Grid(
            f"Several messages, {VIEWS[split]}: {label(quantity)}",
            ("Method", "Picture", "Figures"),
            (*(("Size (MB)",) if scene else ()), *headings(study.captures)),
            tuple(lines),
            tuple(notes),
        )
    )


def _pictures(runs: Sequence[Run]) -> dict[int | None, str]:
    """Titles of the cover (None) and of each message by number, with its name if that is the same in all runs."""
    pictures: dict[int | None, str] = {None: PICTURES["cover"]}
    for number in range(len(runs[0].messages)):
        names = {run.messages[number] for run in runs}
        pictures[number] = f"Message {number + 1}" + (f" · {names.pop()}" if len(names) == 1 else "")
    return pictures


def _size(runs: Sequence[Run], captures: Sequence[str], scene: bool, is_cover: bool) -> list[Cell]:
    """For the first table, the average size in the cover's line, and an empty cell in others; else no cell."""
    if not scene:
        return []
    return [size_cell("container_bytes", measure(runs, size), captures) if is_cover else Cell("")]


def _messages(kinds: Sequence[Kind]) -> Grid:
    shown = [
        Shown((title, picture), group, number)
        for _, title, group in kinds
        for number, picture in _pictures(group).items()
        if number is not None
    ]
    return messages_grid(f"Several messages: {CAPTION}", ("Method", "Message"), shown)
