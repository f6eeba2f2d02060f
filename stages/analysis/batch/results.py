"""The figures of each item of a batch, such as a pair of a cover and a message."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.stage import Item, LineageRecord
from stages.analysis.page.material import PLAIN
from stages.analysis.page.placed import Placed
from stages.analysis.page.tables import PICTURE_QUANTITIES, Column, mean_of
from stages.imaging.metric_table import MetricRow, mean_value, read_rows

COVER, MESSAGE, REFERENCE, SCENE = "cover", "message", "reference", "scene"
PICTURE_COLUMNS = tuple(Column(quantity, "test") for quantity in PICTURE_QUANTITIES)


@dataclass(frozen=True)
class Figure:
    """A column of the table: whose figures these are, and which."""

    subject: str
    column: Column


OWNER_FIGURES = (
    *(Figure(COVER, column) for column in PICTURE_COLUMNS),
    *(Figure(MESSAGE, column) for column in PICTURE_COLUMNS),
    Figure(MESSAGE, Column("psnr_covered", "test")),
    *(Figure(REFERENCE, column) for column in PICTURE_COLUMNS),
    Figure(SCENE, Column("container_bytes")),
    Figure(SCENE, Column("gaussians")),
)
PUBLIC_FIGURES = tuple(figure for figure in OWNER_FIGURES if figure.subject != MESSAGE)


@dataclass(frozen=True)
class Result:
    """One item: what it is called by column, and its figures, NaN where not measured; or why it failed.

    `seconds` is how long all stages behind it worked, what it shares with others included; `placed` of which scenes
    among these it is known how many photos are in them.
    """

    values: Mapping[str, str]
    figures: tuple[float, ...]
    seconds: float
    cause: str | None = None
    placed: tuple[Placed, ...] = ()

    @property
    def made(self) -> bool:
        return self.cause is None


def read_result(
    item: Item, wanted: Sequence[Figure], lineage: Mapping[str, LineageRecord], placed: Sequence[Placed] = ()
) -> Result:
    """The result of an item, its figures in the order of `wanted`, and those of the scenes that it comes from."""
    values = {name: "" if value is None else str(value) for name, value in item.values.items()}
    if item.artifact is None:
        return Result(values, (math.nan,) * len(wanted), math.nan, item.cause or "not made")
    rows = _by_subject(read_rows(item.artifact))
    behind = _behind(item.stage, lineage)
    return Result(
        values or {"stage": item.label},
        tuple(mean_of(rows[figure.subject], figure.column) for figure in wanted),
        math.fsum(record.seconds for record in behind),
        placed=tuple(scene for scene in placed if scene.stage in {record.name for record in behind}),
    )


def measured(results: Sequence[Result], wanted: Sequence[Figure]) -> list[int]:
    """Positions of the figures that some result has."""
    return [index for index in range(len(wanted)) if any(not math.isnan(result.figures[index]) for result in results)]


def mean_figure(results: Sequence[Result], index: int) -> float:
    """The mean of one figure over the results that have it; NaN where none has."""
    return mean_value([MetricRow("", result.figures[index]) for result in results if result.made])


def _by_subject(rows: Sequence[MetricRow]) -> dict[str, list[MetricRow]]:
    """Rows about the first method that was scored, and about plain 3DGS where that is another."""
    first = next((row.method for row in rows), None)
    own = [row for row in rows if row.method == first]
    cover = [row for row in own if row.message is None]
    return {
        COVER: cover,
        MESSAGE: [row for row in own if row.message is not None],
        REFERENCE: [row for row in rows if row.method == PLAIN != first and row.message is None],
        SCENE: cover,
    }


def _behind(stage: str, lineage: Mapping[str, LineageRecord]) -> list[LineageRecord]:
    """The record of a stage and of all that it comes from, each once."""
    found: dict[str, LineageRecord] = {}
    waiting = [stage]
    while waiting:
        name = waiting.pop()
        if name in lineage and name not in found:
            found[name] = lineage[name]
            waiting += lineage[name].inputs
    return list(found.values())
