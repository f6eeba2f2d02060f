"""What the paper's tables say, read from `published.yaml`, and where they contradict themselves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict
from ruamel.yaml import YAML

from stages.analysis.page.material import GS_HIDER

RESOURCES = ("published.yaml",)
FILE = Path(__file__).parent / "published.yaml"
TEXT = FILE.read_text(encoding="utf-8")
CAPTURES = 9

PUBLISHED_AS = {"lpips_vgg": "lpips"}
"""The paper's name of a quantity, where it is not ours: its LPIPS, of a network that it does not name, may be VGG's."""

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
"""A figure for each capture, in the paper's order, and the average as printed."""


class Fidelity(_Model):
    """PSNR of a method, and the size of all that it stores where the table says it."""

    cover: Row
    message: Row | None = None
    megabytes: float | None = None


class Variant(_Model):
    """Averages over all captures for one value of what is varied."""

    value: float
    cover: Figures
    message: Figures


class Rival(_Model):
    """The averages of the best method that was published since, on the paper's captures."""

    name: str
    cover: float
    message: float


class Published(_Model):
    """All tables; quantities are psnr, ssim and lpips, of which the paper does not name the network."""

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
        """What a row says of a capture, NaN where the paper has no such row or no such capture."""
        name = Path(capture).name.casefold()
        return row[self.captures.index(name)] if row is not None and name in self.captures else math.nan


def average(row: Row | None) -> float:
    """The average as printed; NaN without a row."""
    return row[-1] if row is not None else math.nan


def row_of(tables: Published, method: str, subject: Subject, quantity: str) -> Row | None:
    """The row of a method that hides one scene: PSNR of every method, all metrics of GS-Hider; None for all else."""
    if quantity == "psnr" and method in tables.fidelity:
        entry = tables.fidelity[method]
        return entry.cover if subject == "cover" else entry.message
    if method != GS_HIDER:
        return None
    return tables.all_metrics[subject].get(published_name(quantity))


def published_name(quantity: str) -> str:
    """What the paper calls a quantity of ours."""
    return PUBLISHED_AS.get(quantity, quantity)


def read_published() -> Published:
    """The paper's tables."""
    return Published.model_validate(YAML(typ="safe", pure=True).load(TEXT))


def rows_of(tables: Published) -> Iterator[tuple[str, Row]]:
    """Every row with an average, named after the table that it stands in."""
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
