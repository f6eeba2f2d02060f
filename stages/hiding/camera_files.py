"""Camera files of bundles: a viewing path in the public one, and in the secret one the camera that sees a hidden image.

    {"format": "gs-hider cameras", "version": 1,
     "width": 192, "height": 144,               # of a picture, in pixels
     "lens": [fx, fy, cx, cy],                  # shared by all cameras, in pixels; pixel centres are at +0.5
     "world_to_camera": [[r, r, r, t, ...]]}    # for each camera the upper three rows of its matrix, row by row

A camera looks along +z, with x to the right and y down; poses are in the world of the Gaussians. Camera names are not
written, since those of a cover are the names of photos. Numbers survive a round trip bit for bit.
"""

from __future__ import annotations

import json

import numpy as np
from jaxtyping import Float64

from stages.hiding.bundle import VERSION
from stages.scene.cameras import Cameras

CAMERAS_FORMAT = "gs-hider cameras"
MOST_CAMERAS = 2000
"""This many cameras always fit into the bytes that are read from a file."""


def cameras_file(cameras: Cameras) -> str:
    """The text of a camera file. Raises `ValueError` for cameras with different intrinsics or with skew."""
    fx, fy, cx, cy = lens = cameras.intrinsics[0][[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    if (cameras.intrinsics != calibration(fx, fy, cx, cy)).any():
        raise ValueError("cameras of several lenses, or of a skewed one")
    description = {
        "format": CAMERAS_FORMAT,
        "version": VERSION,
        "width": cameras.width,
        "height": cameras.height,
        "lens": lens,
        "world_to_camera": cameras.world_to_camera[:, :3].reshape(-1, 12).tolist(),
    }
    return json.dumps(description) + "\n"


def calibration(fx: float, fy: float, cx: float, cy: float) -> Float64[np.ndarray, "3 3"]:
    """The intrinsic matrix, in pixels, of a camera without skew."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
