"""Rows of figures: what the stages measure and the report tabulates."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError

ROWS_FILE = "rows.jsonl"


@dataclass(frozen=True)
class MetricRow:
    """One figure. ``None`` where a column does not apply.

    view: the picture's name; split: "train" or "test"; message: the message's name, None for the cover (rows with a
    message are private); quantity and unit: see ``QUANTITIES``; value: NaN where it could not be measured;
    iteration: for curves, the training step after which it was measured; method: what made the picture ("plain",
    "gs_hider", …), the row of a table to which the figure belongs.
    """

    quantity: str
    value: float
    unit: str = ""
    view: str | None = None
    split: str | None = None
    message: str | None = None
    iteration: int | None = None
    method: str | None = None


@dataclass(frozen=True)
class Quantity:
    """What a figure measures. ``better`` is "higher", "lower" or "" where neither is."""

    label: str
    unit: str
    better: str
    definition: str


QUANTITIES: dict[str, Quantity] = {
    "psnr": Quantity(
        "PSNR",
        "dB",
        "higher",
        "Peak signal-to-noise ratio, -10 log10 of the mean squared error in colours from 0 to 1.",
    ),
    "ssim": Quantity(
        "SSIM", "", "higher", "Structural similarity: local means, contrasts and correlation in an 11 x 11 window."
    ),
    "lpips_vgg": Quantity("LPIPS", "", "lower", "Learned perceptual distance, version 0.1, between features of VGG16."),
    "lpips_alex": Quantity(
        "LPIPS (AlexNet)", "", "lower", "Learned perceptual distance, version 0.1, between features of AlexNet."
    ),
    "psnr_covered": Quantity("PSNR, covered", "dB", "higher", "PSNR over those pixels only that the message fills."),
    "ssim_covered": Quantity(
        "SSIM, covered", "", "higher", "SSIM averaged over those pixels only that the message fills."
    ),
    "psnr_constant": Quantity(
        "PSNR of a constant",
        "dB",
        "",
        "PSNR, over the same covered pixels, of the best picture of one colour: the floor.",
    ),
    "coverage": Quantity("Coverage", "", "higher", "How much of the picture the message fills, from 0 to 1."),
    "legal": Quantity("Legal", "", "", "1 where the message fills enough of the picture to be scored, otherwise 0."),
    "container_bytes": Quantity("Size", "bytes", "lower", "All that is published, uncompressed."),
    "gaussians": Quantity("Gaussians", "", "lower", "How many Gaussians the scene has."),
    "seconds_per_frame": Quantity(
        "Time a frame", "s", "lower", "Wall-clock time to render one picture, decoding included."
    ),
    "seconds_per_feature_map": Quantity(
        "Time a feature map", "s", "lower", "Wall-clock time to blend one feature map, before it is decoded."
    ),
    "residual_correlation": Quantity(
        "Residual and message",
        "",
        "",
        "Correlation, without sign, of the cover's error with the message of that view.",
    ),
    "residual_correlation_others": Quantity(
        "Residual and others", "", "", "The same with the message of the other test views: what chance gives."
    ),
    "loss": Quantity("Loss", "", "lower", "The training objective, averaged since the previous point of the curve."),
}


def write_rows(writer: ArtifactWriter, rows: Iterable[MetricRow]) -> None:
    """Writes the rows in their order, one JSON object a line, into the artifact's file ``rows.jsonl``."""
    writer.write_file(ROWS_FILE, "".join(_to_line(row) for row in rows))


def read_rows(artifact: Artifact) -> tuple[MetricRow, ...]:
    """The rows of an artifact of kind ``metrics``, in the order written; empty if none were.

    Raises ``UserError`` with the file and line if a row is not one.
    """
    path = artifact.file(ROWS_FILE)
    lines = path.read_text(encoding="utf-8").splitlines()
    return tuple(_from_line(line, f"{path}, line {number}") for number, line in enumerate(lines, start=1))


def _to_line(row: MetricRow) -> str:
    fields = dataclasses.asdict(row)
    for column in ("iteration", "method"):
        if fields[column] is None:
            del fields[column]
    if math.isnan(row.value):
        fields["value"] = None
    elif math.isinf(row.value):  # JSON has no infinity; float() reads this back
        fields["value"] = str(row.value)
    return json.dumps(fields, allow_nan=False, ensure_ascii=False) + "\n"


def _from_line(line: str, where: str) -> MetricRow:
    try:
        fields = json.loads(line)
        fields["value"] = math.nan if fields["value"] is None else float(fields["value"])
        return MetricRow(**fields)
    except (ValueError, TypeError, KeyError) as error:
        raise UserError(
            "a row of figures cannot be read", where=where, found=line[:120], expected="a JSON object of MetricRow"
        ) from error


def mean_value(rows: Sequence[MetricRow]) -> float:
    """The mean of the measured values; NaN if there are none."""
    values = [row.value for row in rows if not math.isnan(row.value)]
    return math.fsum(values) / len(values) if values else math.nan
