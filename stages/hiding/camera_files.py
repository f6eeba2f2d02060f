"""From where to look, in files of bundles: the public one's path, and in the secret one the camera that sees a picture.

    {"format": "gs-hider cameras", "version": 1,
     "width": 192, "height": 144,               # of a picture, in pixels
     "lens": [fx, fy, cx, cy],                  # of every camera, in pixels; pixel centres lie at +0.5
     "world_to_camera": [[r, r, r, t, ...]]}    # the upper three rows of each camera's, by rows

A camera looks down +z with x right and y down, in the world of the Gaussians. Names of cameras are not written, since
those of a cover are names of photos. Numbers come back bit for bit.
"""

from __future__ import annotations

import json

import numpy as np
from jaxtyping import Float64

from stages.hiding.bundle import VERSION
from stages.scene.cameras import Cameras

CAMERAS_FORMAT = "gs-hider cameras"
MOST_CAMERAS = 2000
"""So many are always fewer bytes than are read of a file."""


def cameras_file(cameras: Cameras) -> str:
    """Cameras of one lens as the text of a file. Raises `ValueError` for several lenses or a skewed one."""
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
    """The matrix of a lens without skew, in pixels."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
