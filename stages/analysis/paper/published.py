"""The paper's tables, read from `published.yaml`, and which of their averages are not those of their rows."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict
from ruamel.yaml import YAML

from stages.analysis.method_titles import GS_HIDER

RESOURCES = ("published.yaml",)
FILE = Path(__file__).parent / "published.yaml"
TEXT = FILE.read_text(encoding="utf-8")
CAPTURES = 9

PUBLISHED_AS = {"lpips_vgg": "lpips"}
"""The paper's names of quantities, if they differ from ours. Which network its LPIPS uses is not stated; it may be VGG.
"""

Subject = Literal["cover", "message"]
Ablated = Literal["lambda_message", "feature_dim", "layers"]
Figures = Mapping[str, float]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _complete(row: tuple[float, ...]) -> tuple[float, ...]:
    if len(row) != CAPTURES + 1:
        raise ValueError(f"{len(row)} figures; expected one for each of {CAPTURES} captures, and their average")
    return row


Row = Annotated[tuple[float, ...], AfterValidator(_complete)]
"""A figure for each capture, in the paper's order, followed by the average as printed."""


class Fidelity(_Model):
    """PSNR of a method, and the size of everything that it stores, if the table has it."""

    cover: Row
    message: Row | None = None
    megabytes: float | None = None


class Variant(_Model):
    """Averages over all captures for one value of the setting that is varied."""

    value: float
    cover: Figures
    message: Figures


class Rival(_Model):
    """The averages of the best method published since, on the paper's captures."""

    name: str
    cover: float
    message: float


class Published(_Model):
    """All tables. Quantities are psnr, ssim and lpips; the paper does not name the network of the last."""

    captures: tuple[str, ...]
    messages: Mapping[str, str]
    setup: Figures
    fidelity: Mapping[str, Fidelity]
    seconds_per_frame: Mapping[str, Row]
    all_metrics: Mapping[Subject, Mapping[str, Row]]
    no_message: Mapping[str, Row]
    single_image: Mapping[str, Fidelity]
    traceable_watermark: Mapping[str, Figures]
    ablations: Mapping[Ablated, tuple[Variant, ...]]
    pruning: Mapping[str, tuple[Variant, ...]]
    rival: Rival
    purification: Figures

    def figure(self, row: Row | None, capture: str) -> float:
        """A row's figure for a capture; NaN without a row, or if the paper does not have the capture."""
        return row[self.captures.index(_named(capture))] if row is not None and self.has(capture) else math.nan

    def has(self, capture: str) -> bool:
        """Whether one of the paper's captures is called like this."""
        return _named(capture) in self.captures

    def other_message(self, capture: str, messages: Iterable[str]) -> str | None:
        """What the paper hides in a capture if that is none of these messages; None if it is, or without the capture.

        Figures of the paper's message then are of another picture than ours.
        """
        hidden = self.messages.get(_named(capture))
        return None if hidden in {_named(message) for message in messages} else hidden


def _named(capture: str) -> str:
    """A capture's name in the paper, given its folder here."""
    return Path(capture).name.casefold()


def average(row: Row | None) -> float:
    """The average as printed; NaN without a row."""
    return row[-1] if row is not None else math.nan


def row_of(tables: Published, method: str, subject: Subject, quantity: str) -> Row | None:
    """The paper's row for a method that hides one scene; None if it has none.

    It gives the PSNR of every method, and all metrics of GS-Hider.
    """
    if quantity == "psnr" and method in tables.fidelity:
        entry = tables.fidelity[method]
        return entry.cover if subject == "cover" else entry.message
    if method != GS_HIDER:
        return None
    return tables.all_metrics[subject].get(published_name(quantity))


def published_name(quantity: str) -> str:
    """The paper's name of one of our quantities."""
    return PUBLISHED_AS.get(quantity, quantity)


def read_published() -> Published:
    """Read the paper's tables."""
    return Published.model_validate(YAML(typ="safe", pure=True).load(TEXT))


def rows_of(tables: Published) -> Iterator[tuple[str, Row]]:
    """Every row with an average, named after the table that it is in."""
    for title, table in (("Fidelity", tables.fidelity), ("Single image", tables.single_image)):
        for method, entry in table.items():
            yield f"{title}, {method}, cover", entry.cover
            if entry.message is not None:
                yield f"{title}, {method}, message", entry.message
    for method, row in tables.seconds_per_frame.items():
        yield f"Rendering time, {method}", row
    for subject, metrics in tables.all_metrics.items():
        yield from ((f"All metrics, {subject}, {quantity}", row) for quantity, row in metrics.items())
    yield from ((f"No message, {quantity}", row) for quantity, row in tables.no_message.items())


def wrong_averages(tables: Published) -> tuple[tuple[str, float, float], ...]:
    """Rows whose printed average is not the mean of their figures to the last digit: name, average, mean."""
    found = []
    for name, row in rows_of(tables):
        mean = math.fsum(row[:-1]) / CAPTURES
        digits = max(_digits(figure) for figure in row)
        if abs(mean - row[-1]) > 0.5 * 10**-digits * (1 + 1e-9):
            found.append((name, row[-1], mean))
    return tuple(found)


def _digits(figure: float) -> int:
    return len(str(figure).partition(".")[2])
