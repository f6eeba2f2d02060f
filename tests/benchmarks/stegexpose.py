"""Times StegExpose's detectors on a picture, against the Java original.

    python -m tests.benchmarks.stegexpose [PICTURE]

Without PICTURE, it makes one of 640x427 pixels, for which the original takes 0.7 s. Measure on an idle machine.
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path

import numpy as np

from stages.analysis.stegexpose.fusion import DETECTORS, stegexpose
from stages.imaging.pictures import Picture, read_picture

ORIGINAL = 0.7
"""Seconds of StegExpose 0.1 for 640x427 pixels."""
ASKED_FOR = 5
REPETITIONS = 20


def photo_like(width: int = 640, height: int = 427) -> Picture:
    """A smooth picture with noise like that of sensors."""
    generator = np.random.default_rng(0)
    rows, columns = np.mgrid[0:height, 0:width]
    smooth = 120 + 60 * np.sin(rows / 47) + 50 * np.cos(columns / 83)
    return (smooth[..., None] + generator.normal(0, 3, (height, width, 3))).clip(0, 255).astype(np.uint8)


def median_seconds(work: object, picture: Picture) -> float:
    seconds = []
    for _ in range(REPETITIONS + 1):
        start = time.perf_counter()
        work(picture)  # type: ignore[operator]
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds[1:])


def main() -> None:
    picture = read_picture(Path(sys.argv[1])) if len(sys.argv) > 1 else photo_like()
    height, width, _ = picture.shape
    for name, detector in DETECTORS.items():
        print(f"{name:14} {1e3 * median_seconds(detector, picture):7.1f} ms")
    seconds = median_seconds(stegexpose, picture)
    original = ORIGINAL * height * width / (640 * 427)
    print(f"{'all':14} {1e3 * seconds:7.1f} ms for {width}x{height}")
    print(f"{original / seconds:.1f} times as fast as the original; asked for: {ASKED_FOR}")


if __name__ == "__main__":
    main()
