"""Several scenes hidden in one: what each further one costs. The paper shows pictures of it, and no figures."""

from __future__ import annotations

from collections.abc import Sequence

from stages.analysis.page.material import PLAIN
from stages.analysis.paper.chapter import (
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
    figure_cell,
    headings,
    measured_cells,
    without_empty_columns,
)
from stages.analysis.paper.measuring import Figure, Measured, Spread, cover, measure, of_message, size
from stages.analysis.paper.published import Published
from stages.analysis.paper.runs import Run, Study, by_kind


def several_messages(study: Study, tables: Published) -> Chapter:
    """Scenes that hide one message, and more."""
    hiding = study.select(lambda run: bool(run.messages) and not run.hides_image)
    many = {run.method for run in hiding if len(run.messages) > 1}
    chosen = [run for run in hiding if run.method in many] + list(study.select(lambda run: run.method == PLAIN))
    runs = usual(chosen)
    plain = of_method(runs, PLAIN, cover("psnr"))
    lines: list[Line] = []
    for method, title, group in blocks(runs):
        for alike in by_kind(group).values():
            lines += _lines(title, alike, None if method == PLAIN else plain, study.captures)
    grid = Grid(
        "Several messages, test views: PSNR (dB)",
        ("Method", "Picture", "Figures"),
        ("Size (MB)", *headings(study.captures)),
        tuple(lines),
        ("The paper gives no figures.", noise_note(noises(runs, study))),
    )
    return Chapter("Several scenes hidden in one", (without_empty_columns(grid),), (), runs)


def nth_message(number: int) -> Figure:
    """The PSNR of the message with this number, from 0, on test views."""
    return lambda run: of_message(run, run.messages[number], "psnr")


def _lines(title: str, runs: Sequence[Run], plain: Measured | None, captures: Sequence[str]) -> list[Line]:
    count = len(runs[0].messages)
    name = title if not count else f"{title}, {count} message{'s' if count > 1 else ''}"
    bytes_ = figure_cell("container_bytes", Spread(measure(runs, size).average.mean))
    lines = [
        Line((name, "Cover", HERE), (bytes_, *measured_cells("psnr", measure(runs, cover("psnr")), plain, captures)))
    ]
    for number in range(count):
        names = sorted({run.messages[number] for run in runs})
        picture = f"Message {number + 1}" + (f" · {names[0]}" if len(names) == 1 else "")
        cells = measured_cells("psnr", measure(runs, nth_message(number)), None, captures)
        lines.append(Line((name, picture, HERE), (Cell(""), *cells)))
    return lines
