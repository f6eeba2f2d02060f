"""Reading a `transforms.json` of NeRF, instant-ngp or nerfstudio: camera-to-world poses with OpenGL's axes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from pipeline.errors import UserError
from pipeline.plain_text import in_a_line
from stages.scene.colmap import PosedPhoto, refuse_far
from stages.scene.lens import TWO_FOCAL_LENGTHS, Lens

FILE = "transforms.json"
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's cameras look down -z with y up
ROTATION_TOLERANCE = 1e-2  # files hold rounded numbers; what is further from a rotation is a mistake

DISTORTIONS = {
    "SIMPLE_PINHOLE": (),
    "PINHOLE": (),
    "SIMPLE_RADIAL": ("k1",),
    "RADIAL": ("k1", "k2"),
    "OPENCV": ("k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"),
}
"""Distortion parameters of the supported camera models, in COLMAP's order."""
OTHER_LENSES = ("latlong", "equirectangular", "ftheta_p0")
"""Keys by which instant-ngp states a lens that has no pinhole's focal length."""
INTRINSICS = frozenset(
    (
        *("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y", "x_fov", "y_fov"),
        *("camera_model", "is_fisheye", "k1", "k2", "k3", "k4", "p1", "p2", *OTHER_LENSES),
    )
)
"""Keys that the file may state for all frames, or per frame."""
FOCAL_LENGTHS = {axis: (f"fl_{axis}", f"camera_angle_{axis}", f"{axis}_fov") for axis in "xy"}
"""Keys for the focal length along an axis, in order of precedence."""
IN_PIXELS = frozenset(("fl_x", "fl_y", "cx", "cy"))


def read_transforms(
    path: Path, size_of: Callable[[str], tuple[int, int]], *, resized: bool = False
) -> list[PosedPhoto]:
    """The file's frames as posed photos, sorted by name; `size_of(name)` gives width and height if the file does not.

    Intrinsics may be global or per frame: `fl_x`, `camera_angle_x` or `x_fov`, likewise for y (one of both axes is
    enough), `cx`, `cy`, `k1` to `k4`, `p1`, `p2`, and `camera_model` or `is_fisheye`. A photo's name is its
    `file_path`, with or without extension. If photos are `resized`, intrinsics in pixels require `w` and `h`, as the
    photos' sizes do not tell what they refer to. Raises `UserError` for an unreadable file, and for a frame, which it
    names, without a usable pose or intrinsics.
    """
    content = _content(path)
    shared = {name: content[name] for name in INTRINSICS & content.keys()}
    photos = []
    for number, frame in enumerate(content["frames"]):
        try:
            photos.append(_posed_photo(shared, frame, size_of, resized))
        except (KeyError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
            name = in_a_line(str(frame.get("file_path", number) if isinstance(frame, dict) else number))
            raise UserError(
                f"frame {name} has no usable pose or intrinsics",
                where=path,
                found=f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error),
                expected="file_path, a finite 4x4 transform_matrix, and fl_x or camera_angle_x",
                remedy=f"Repair the frame, or take {path.name} out of the folder to have the poses estimated.",
            ) from error
    return sorted(photos, key=lambda photo: photo.name)


def frame_files(path: Path) -> list[str]:
    """The `file_path` of each frame, relative to the file, with or without extension; "" if it has none."""
    frames = _content(path)["frames"]
    named = [frame.get("file_path", "") if isinstance(frame, Mapping) else "" for frame in frames]
    return [_slashed(name) if isinstance(name, str) else "" for name in named]


def held_out_files(path: Path) -> list[str]:
    """The paths of the photos that nerfstudio's `test_filenames` holds out; empty if there is no such list.

    The file needs no `frames`: beside a COLMAP model it may hold the list alone. Raises `UserError` if it is no JSON
    object, or the list holds anything but text.
    """
    listed = _json_object(path).get("test_filenames") or []
    if not isinstance(listed, list) or not all(isinstance(name, str) for name in listed):
        raise UserError(
            "the test photos cannot be read",
            where=path,
            found=f"test_filenames: {json.dumps(listed)}",
            expected="test_filenames: a list of the paths of photos",
            remedy="Repair the list, or take it out of the file.",
        )
    return [_slashed(name) for name in listed]


def points_file(path: Path) -> str | None:
    """The path of the points, relative to the file, from nerfstudio's `ply_file_path`; None if not stated."""
    named = _content(path).get("ply_file_path")
    return _slashed(named) if isinstance(named, str) and named else None


def masked_frames(path: Path) -> int:
    """How many frames name a mask (nerfstudio's `mask_path`); 0 without frames, as beside a COLMAP model."""
    frames = _json_object(path).get("frames")
    frames = frames if isinstance(frames, list) else []
    return sum(isinstance(frame, Mapping) and bool(frame.get("mask_path")) for frame in frames)


def _slashed(path: str) -> str:
    """The path with slashes for the backslashes that Blender's exporters write on Windows; no photo's name has any."""
    return path.replace("\\", "/")


def _content(path: Path) -> Mapping[str, Any]:
    content = _json_object(path)
    if not isinstance(content.get("frames"), list):
        raise _unreadable(path, "frames is missing, or not a list")
    return content


def _json_object(path: Path) -> Mapping[str, Any]:
    try:
        content = json.loads(path.read_text("utf-8-sig"))
    except (ValueError, OSError, RecursionError) as error:
        raise _unreadable(path, f"{type(error).__name__}: {error}") from error
    if not isinstance(content, Mapping):
        raise _unreadable(path, f"{json.dumps(content)}, which is no object")
    return content


def _unreadable(path: Path, found: str) -> UserError:
    return UserError(
        "a file of poses cannot be read",
        where=path,
        found=found,
        expected="a JSON object with a list `frames`, as NeRF and instant-ngp write it",
        remedy="Repair the file, or take it out of the folder.",
    )


def _posed_photo(
    shared: Mapping[str, Any], frame: Mapping[str, Any], size_of: Callable[[str], tuple[int, int]], resized: bool
) -> PosedPhoto:
    name, given = Path(_slashed(frame["file_path"])).as_posix(), {**_left_by(frame, shared), **frame}
    if resized and IN_PIXELS & given.keys() and not {"w", "h"} <= given.keys():
        raise ValueError("w and h are missing: resized photos do not tell what intrinsics in pixels are relative to")
    return PosedPhoto(name, _pose(frame["transform_matrix"]), _lens(given, lambda: size_of(name)))


def _left_by(frame: Mapping[str, Any], shared: Mapping[str, Any]) -> dict[str, Any]:
    """The shared intrinsics that a frame does not override; an angle also overrides a focal length, and vice versa."""
    given = {word for words in FOCAL_LENGTHS.values() if not frame.keys().isdisjoint(words) for word in words}
    return {name: value for name, value in shared.items() if name not in given}


def _pose(matrix: object) -> Float64[np.ndarray, "4 4"]:
    camera_to_world = np.array(matrix, np.float64)
    if camera_to_world.shape not in ((3, 4), (4, 4)):
        raise ValueError(f"a transform_matrix of shape {camera_to_world.shape}")
    if not np.isfinite(camera_to_world).all():
        raise ValueError("a transform_matrix with NaN or infinity")
    refuse_far("a transform_matrix", camera_to_world[:3, 3])
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
    down = _focal_length(given, "y", height)
    across = _focal_length(given, "x", width)
    across = down if across is None else across  # instant-ngp, too, takes either for both
    if across is None:
        raise KeyError("fl_x or camera_angle_x")
    down = down or across
    centre = (float(given.get("cx", width / 2)), float(given.get("cy", height / 2)))
    model, distortion = _distortion(given)
    return Lens(model, (across, down, *centre, *distortion), width, height)


def _distortion(given: Mapping[str, Any]) -> tuple[str, list[float]]:
    """COLMAP's model with two focal lengths, and its distortion parameters, zero where not given."""
    other = next((name for name in OTHER_LENSES if given.get(name, False) is not False), None)
    stated = other or given.get("camera_model", "OPENCV_FISHEYE" if given.get("is_fisheye") else "OPENCV")
    if stated not in DISTORTIONS:
        raise ValueError(f"camera_model {stated}; known are {', '.join(DISTORTIONS)}")
    values = {name: float(given.get(name, 0)) for name in ("k1", "k2", "k3", "k4", "p1", "p2")}
    own = (*DISTORTIONS[stated], "k3") if stated == "OPENCV" else DISTORTIONS[stated]
    for name, value in values.items():
        if value and name not in own:
            raise ValueError(f"{name} of {value:g}, which {stated} does not have")
    model = TWO_FOCAL_LENGTHS.get(stated, stated)
    distortion = [values[name] for name in DISTORTIONS[model]]
    if model == "OPENCV" and values["k3"]:
        return "FULL_OPENCV", [*distortion, values["k3"], 0.0, 0.0, 0.0]
    return model, distortion


def _focal_length(given: Mapping[str, Any], axis: str, size: int) -> float | None:
    if f"fl_{axis}" in given:
        return float(given[f"fl_{axis}"])
    degrees = given.get(f"{axis}_fov")
    angle = given.get(f"camera_angle_{axis}", None if degrees is None else math.radians(float(degrees)))
    return None if angle is None else size / 2 / math.tan(float(angle) / 2)
