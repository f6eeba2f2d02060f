"""The figures of each item of a batch, such as a pair of a cover and a message."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.stage import Item, LineageRecord
from stages.analysis.page.placed import Placed
from stages.analysis.page.tables import PICTURE_QUANTITIES, Column, mean_of
from stages.hiding.method_names import PLAIN
from stages.imaging.metric_table import MetricRow, mean_value, read_rows

COVER, MESSAGE, REFERENCE, SCENE = "cover", "message", "reference", "scene"
ITEM = "Item"
"""Heading of what the scores of a row are called, such as `scores[fox,kitchen]`; its other results end alike."""
PICTURE_COLUMNS = tuple(Column(quantity, "test") for quantity in PICTURE_QUANTITIES)


@dataclass(frozen=True)
class Figure:
    """A column of the batch's table: the subject of its figures, and the quantity with its split."""

    subject: str
    column: Column


LEGAL = Figure(MESSAGE, Column("legal", "test"))
"""The share of views that the message fills enough for its figures to mean something."""

OWNER_FIGURES = (
    *(Figure(COVER, column) for column in PICTURE_COLUMNS),
    *(Figure(MESSAGE, column) for column in PICTURE_COLUMNS),
    Figure(MESSAGE, Column("psnr_covered", "test")),
    Figure(MESSAGE, Column("psnr_constant", "test")),
    LEGAL,
    *(Figure(REFERENCE, column) for column in PICTURE_COLUMNS),
    Figure(SCENE, Column("container_bytes")),
    Figure(SCENE, Column("gaussians")),
)
PUBLIC_FIGURES = tuple(figure for figure in OWNER_FIGURES if figure.subject != MESSAGE)


@dataclass(frozen=True)
class Result:
    """The result of one item: its `values` by column, and its figures, NaN if not measured; or the cause of failure.

    `item` is the name of the stage that scored it, empty where that is not to be told. `seconds` is the total time of
    all stages behind it, including those shared with other items. `placed` are the scenes behind it whose numbers of
    placed photos are known. `hardly_seen`: a message was scored on test views, of which none is legal.
    """

    item: str
    values: Mapping[str, str]
    figures: tuple[float, ...]
    seconds: float
    cause: str | None = None
    placed: tuple[Placed, ...] = ()
    hardly_seen: bool = False

    @property
    def made(self) -> bool:
        """Whether the item succeeded."""
        return self.cause is None

    def names(self, headings: Sequence[str]) -> tuple[str, ...]:
        """What stands under the headings of its names: its item under `ITEM`, its values under their columns."""
        return tuple(self.item if heading == ITEM else self.values.get(heading, "") for heading in headings)


def read_result(
    item: Item, wanted: Sequence[Figure], lineage: Mapping[str, LineageRecord], placed: Sequence[Placed] = ()
) -> Result:
    """The result of an item, with figures in the order of `wanted`, and those of the `placed` scenes behind it."""
    values = {name: "" if value is None else str(value) for name, value in item.values.items()}
    if item.artifact is None:
        return Result(item.stage, values, (math.nan,) * len(wanted), math.nan, item.cause or "not made")
    rows = _by_subject(read_rows(item.artifact))
    behind = _behind(item.stage, lineage)
    return Result(
        item.stage,
        values,
        tuple(mean_of(rows[figure.subject], figure.column) for figure in wanted),
        math.fsum(record.seconds for record in behind),
        placed=tuple(scene for scene in placed if scene.stage in {record.name for record in behind}),
        hardly_seen=_has_hardly_seen(rows[MESSAGE]),
    )


def measured(results: Sequence[Result], wanted: Sequence[Figure]) -> list[int]:
    """Positions of the figures that at least one result has."""
    return [index for index in range(len(wanted)) if any(not math.isnan(result.figures[index]) for result in results)]


def mean_figure(results: Sequence[Result], index: int) -> float:
    """The mean of one figure over the results that have it; NaN if none has."""
    return mean_value([MetricRow("", result.figures[index]) for result in results if result.made])


def _has_hardly_seen(rows: Sequence[MetricRow]) -> bool:
    legal: dict[str | None, bool] = {}
    for row in rows:
        if (row.quantity, row.split) == (LEGAL.column.quantity, LEGAL.column.split):
            legal[row.message] = legal.get(row.message, False) or row.value > 0
    return not all(legal.values())


def _by_subject(rows: Sequence[MetricRow]) -> dict[str, list[MetricRow]]:
    """Rows of the first scored method by subject, and as REFERENCE those of plain 3DGS if it is another method."""
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
    """The records of a stage and of all stages behind it, each once."""
    found: dict[str, LineageRecord] = {}
    waiting = [stage]
    while waiting:
        name = waiting.pop()
        if name in lineage and name not in found:
            found[name] = lineage[name]
            waiting += lineage[name].inputs
    return list(found.values())
