from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from pipeline.artifact import create, load
from pipeline.errors import UserError
from stages.imaging.metric_table import MetricRow, mean_value, read_rows, write_rows

ROWS = (
    MetricRow("psnr", 27.25, "dB", view="0001.png", split="test"),
    MetricRow("psnr", math.inf, "dB", view="0001.png", split="test", message="réef"),
    MetricRow("loss", 0.125, iteration=300),
    MetricRow("psnr", 20.0, "dB", view="ends\u2028a\x85line.png", split="test"),
)


def test_rows_come_back_as_written(tmp_path: Path) -> None:
    with create(tmp_path / "metrics", "metrics") as writer:
        write_rows(writer, ROWS)
    artifact = load(tmp_path / "metrics")
    assert read_rows(artifact) == ROWS
    lines = [json.loads(line) for line in artifact.file("rows.jsonl").read_text(encoding="utf-8").splitlines()]
    assert list(lines[0]) == ["quantity", "value", "unit", "view", "split", "message"]
    assert lines[0]["message"] is None
    assert lines[2]["iteration"] == 300


def test_what_could_not_be_measured_is_null(tmp_path: Path) -> None:
    with create(tmp_path / "metrics", "metrics") as writer:
        write_rows(writer, [MetricRow("lpips_vgg", math.nan)])
    artifact = load(tmp_path / "metrics")
    assert json.loads(artifact.file("rows.jsonl").read_text())["value"] is None
    assert math.isnan(read_rows(artifact)[0].value)


@pytest.mark.parametrize("line", ["{", '{"quantity": "psnr"}', '{"quantity": "psnr", "value": 1, "colour": 2}', "[]"])
def test_damaged_rows_are_named_by_line(tmp_path: Path, line: str) -> None:
    with create(tmp_path / "metrics", "metrics") as writer:
        writer.write_file("rows.jsonl", json.dumps({"quantity": "psnr", "value": 1}) + "\n" + line + "\n")
    with pytest.raises(UserError, match="line 2"):
        read_rows(load(tmp_path / "metrics"))


def test_mean_skips_what_was_not_measured() -> None:
    assert mean_value([MetricRow("psnr", value) for value in (20.0, math.nan, 30.0)]) == 25
    assert math.isnan(mean_value([]))
