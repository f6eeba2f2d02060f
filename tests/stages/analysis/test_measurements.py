from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from pipeline.artifact import create, load
from pipeline.errors import UserError
from stages.analysis.measurements import (
    KIND,
    MEASUREMENTS_FILE,
    Measurement,
    read_measurements,
    write_measurements,
)

ROWS = (
    Measurement("psnr", 27.25, "random_pruning", 0.15, 1, split="test", method="gs_hider"),
    Measurement("psnr", math.inf, "quantisation", 8.0, view="0001.png", split="test", message="réef"),
    Measurement("stegexpose_fusion", 0.125, "photos"),
    Measurement("psnr", 20.0, "photos", view="ends\u2028a\x85line.png"),
)


def test_rows_come_back_as_written(tmp_path: Path) -> None:
    with create(tmp_path / "rows", KIND) as writer:
        write_measurements(writer, ROWS)
    artifact = load(tmp_path / "rows")
    assert read_measurements(artifact) == ROWS
    lines = [json.loads(line) for line in artifact.file(MEASUREMENTS_FILE).read_text(encoding="utf-8").splitlines()]
    assert list(lines[2]) == ["quantity", "value", "condition"]


def test_what_could_not_be_measured_comes_back_as_nan(tmp_path: Path) -> None:
    with create(tmp_path / "rows", KIND) as writer:
        write_measurements(writer, [Measurement("psnr", math.nan, "cropping", 0.5)])
    assert math.isnan(read_measurements(load(tmp_path / "rows"))[0].value)


@pytest.mark.parametrize("line", ["{", '{"quantity": "psnr", "value": 1}', '{"value": 1, "colour": 2}', "[]"])
def test_damaged_rows_are_named_by_line(tmp_path: Path, line: str) -> None:
    with create(tmp_path / "rows", KIND) as writer:
        writer.write_file(MEASUREMENTS_FILE, '{"quantity": "a", "value": 1, "condition": "b"}\n' + line + "\n")
    with pytest.raises(UserError, match="line 2"):
        read_measurements(load(tmp_path / "rows"))
