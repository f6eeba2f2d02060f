"""Reading a `transforms.json` as NeRF and instant-ngp write it: camera to world, in OpenGL's camera convention."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from pipeline.errors import UserError
from stages.scene.colmap import PosedPhoto
from stages.scene.lens import Lens

FILE = "transforms.json"
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's cameras look down -z with y up
ROTATION_TOLERANCE = 1e-2  # files hold rounded numbers; what is further from a rotation is a mistake


def read_transforms(path: Path, size_of: Callable[[str], tuple[int, int]]) -> list[PosedPhoto]:
    """The frames of the file, sorted by name; `size_of` tells a photo's width and height where the file does not.

    Intrinsics may be global or a frame's own: `fl_x` or `camera_angle_x`, `fl_y`, `cx`, `cy`, `k1` to `k4`, `p1`,
    `p2`, `camera_model`. A name is the last part of `file_path`, with or without extension. Raises `UserError` naming
    the frame whose pose is missing, not finite or no rotation, and what is wrong otherwise.
    """
    try:
        content = json.loads(path.read_text())
        frames = content["frames"]
        if not isinstance(frames, list):
            raise ValueError("frames is not a list")
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise UserError(
            "a file of poses cannot be read",
            where=path,
            found=f"{type(error).__name__}: {error}",
            expected="a JSON object with a list `frames`, as NeRF and instant-ngp write it",
        ) from error
    photos = []
    for number, frame in enumerate(frames):
        try:
            photos.append(_posed_photo(content, frame, size_of))
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            name = frame.get("file_path", number) if isinstance(frame, dict) else number
            raise UserError(
                f"frame {name} has no usable pose or intrinsics",
                where=path,
                found=f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error),
                expected="file_path, a finite 4x4 transform_matrix, and fl_x or camera_angle_x",
                remedy=f"Repair the frame, or take {FILE} out of the folder to have the poses estimated.",
            ) from error
    return sorted(photos, key=lambda photo: photo.name)


def _posed_photo(
    content: Mapping[str, Any], frame: Mapping[str, Any], size_of: Callable[[str], tuple[int, int]]
) -> PosedPhoto:
    name = Path(frame["file_path"]).name
    return PosedPhoto(name, _pose(frame["transform_matrix"]), _lens({**content, **frame}, lambda: size_of(name)))


def _pose(matrix: object) -> Float64[np.ndarray, "4 4"]:
    camera_to_world = np.array(matrix, np.float64)
    if camera_to_world.shape not in ((3, 4), (4, 4)):
        raise ValueError(f"a transform_matrix of shape {camera_to_world.shape}")
    if not np.isfinite(camera_to_world).all():
        raise ValueError("a transform_matrix with NaN or infinity")
    camera_to_world = np.vstack([camera_to_world[:3], [0, 0, 0, 1]]) @ OPENGL_TO_OPENCV
    left, stretch, right = np.linalg.svd(camera_to_world[:3, :3])
    if np.abs(stretch - 1).max() > ROTATION_TOLERANCE or np.linalg.det(left @ right) < 0:
        raise ValueError("a transform_matrix that is no rotation and translation")
    rotation = left @ right
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -rotation.T @ camera_to_world[:3, 3]
    return pose


def _lens(given: Mapping[str, Any], size: Callable[[], tuple[int, int]]) -> Lens:
    width, height = (int(given["w"]), int(given["h"])) if "w" in given and "h" in given else size()
    across = _focal_length(given, "x", width)
    if across is None:
        raise KeyError("fl_x or camera_angle_x")
    down = _focal_length(given, "y", height) or across
    centre = (float(given.get("cx", width / 2)), float(given.get("cy", height / 2)))
    model = given.get("camera_model", "OPENCV")
    if model == "SIMPLE_PINHOLE":
        model = "PINHOLE"
    if model not in ("OPENCV", "OPENCV_FISHEYE", "PINHOLE"):
        raise ValueError(f"camera_model {model}; known are OPENCV, OPENCV_FISHEYE, PINHOLE")
    names = {"OPENCV": ("k1", "k2", "p1", "p2"), "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"), "PINHOLE": ()}[model]
    distortion = [float(given.get(name, 0)) for name in names]
    if model == "OPENCV" and (given.get("k3") or given.get("k4")):
        model, distortion = "FULL_OPENCV", [*distortion, float(given.get("k3", 0)), 0.0, 0.0, 0.0]
    return Lens(model, (across, down, *centre, *distortion), width, height)


def _focal_length(given: Mapping[str, Any], axis: str, size: int) -> float | None:
    if f"fl_{axis}" in given:
        return float(given[f"fl_{axis}"])
    angle = given.get(f"camera_angle_{axis}")
    return None if angle is None else size / 2 / math.tan(float(angle) / 2)
