"""Fisheyes whose corners see beyond 90 degrees show as much as a pinhole can, and no less than narrower ones."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

DESCRIBE = """
import json, sys
import numpy as np
import pycolmap
from stages.scene.reconstruction_process import view_of
from stages.scene.undistortion import shared_pinhole

def half_width(focal):
    parameters = [focal, focal, 401, 299, 0, 0, 0, 0]
    camera = pycolmap.Camera(model="OPENCV_FISHEYE", width=802, height=598, params=parameters, camera_id=1)
    pinhole = shared_pinhole([view_of(camera)], 200, 148)
    return float(np.degrees(np.arctan(100 / pinhole.intrinsics[0, 0])))

print(json.dumps([half_width(float(focal)) for focal in sys.argv[1:]]))
"""


def half_widths(*focal_lengths: float) -> list[float]:
    """Degrees from the middle to the side of the picture. pycolmap is imported in a process of its own."""
    command = [sys.executable, "-c", DESCRIBE, *map(str, focal_lengths)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, cwd=Path(__file__).parents[3]).stdout
    widths: list[float] = json.loads(printed)
    return widths


def test_a_wider_lens_shows_no_less() -> None:
    """Corners at 57, 87, 90, 96 and 106 degrees, and a lens whose whole left side is beyond 90."""
    narrow, *wide = half_widths(500, 330, 318, 300, 270, 230)
    assert narrow < 45
    assert wide == pytest.approx([60.0] * 5, abs=0.5)
    assert wide == sorted(wide)
