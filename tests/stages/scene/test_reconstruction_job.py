"""What the process of structure from motion returns is never in memory twice, nor all at once."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stages.scene.reconstruction_job import read_corners, write_corners

LENSES, ROWS, COLUMNS = 40, 300, 400
ONE = ROWS * COLUMNS * 2 * 4
"""Bytes of one lens's corners."""


def corners() -> Iterator[np.ndarray]:
    for lens in range(LENSES):
        yield np.full((ROWS, COLUMNS, 2), lens, np.float32)


def test_corners_of_many_lenses_are_written_and_read_one_by_one(tmp_path: Path) -> None:
    tracemalloc.start()
    try:
        write_corners(tmp_path, (LENSES, ROWS, COLUMNS, 2), corners())
        read = read_corners(tmp_path)
        assert [float(np.asarray(read[lens]).mean()) for lens in range(LENSES)] == list(range(LENSES))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert read.shape == (LENSES, ROWS, COLUMNS, 2)
    assert peak < 5 * ONE
