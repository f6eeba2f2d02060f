"""A capture: photos as taken, and what is known of their cameras before structure from motion."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float64

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError
from stages.scene.known_points import KnownPoints, read_points, write_points
from stages.scene.lens import Lens

PoseSource = Literal["colmap", "transforms", "synthetic"]
"""Where poses come from: a COLMAP model, a transforms.json, or the scene that the pictures were rendered from."""

PICTURES = "pictures"
MOST_OF_A_SEQUENCE = 0.9
"""Fraction of names that must share one word, if photos are to count as numbered in the order of taking."""


@dataclass(frozen=True)
class KnownPoses:
    """Given poses of V photos: world to camera, looking along +z (OpenCV), with the lens of each photo.

    `points` are those that came with the poses, or None.
    """

    source: PoseSource
    world_to_camera: Float64[np.ndarray, "V 4 4"]
    lenses: tuple[Lens, ...]
    points: KnownPoints | None = None


@dataclass(frozen=True)
class Capture:
    """V photos, sorted by name.

    `names` are file names. `sizes` are the width and height of each picture as `read_picture` decodes it,
    `focal_pixels` its focal length in pixels by EXIF, or None. `ordered`: the numbers in the names follow the order in
    which the photos were taken. `taken_by`: the number of each photo's camera, as far as cameras can be told apart;
    empty if unknown. `test_names`: the photos that the pose files hold out for testing; empty if they name none.
    """

    names: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    focal_pixels: tuple[float | None, ...]
    ordered: bool
    poses: KnownPoses | None = None
    taken_by: tuple[int, ...] = ()
    test_names: tuple[str, ...] = ()


def write_capture(writer: ArtifactWriter, capture: Capture, picture_of: Callable[[str], bytes | Path]) -> None:
    """Write a `capture` artifact. `picture_of(name)` gives a photo's encoded bytes, or the file to copy.

    It is called for one photo after another, so that no two need to be in memory at once.
    """
    for name in capture.names:
        source = picture_of(name)
        writer.write_file(f"{PICTURES}/{name}", source if isinstance(source, bytes) else source.read_bytes())
    writer.attributes.update(
        names=list(capture.names),
        sizes=[list(size) for size in capture.sizes],
        focal_pixels=list(capture.focal_pixels),
        ordered=capture.ordered,
        taken_by=list(capture.taken_by),
        poses="none" if capture.poses is None else capture.poses.source,
    )
    if capture.test_names:
        writer.attributes["test_names"] = list(capture.test_names)
    if capture.poses is not None:
        writer.write("world_to_camera", capture.poses.world_to_camera)
        writer.write("intrinsics", np.stack([lens.matrix() for lens in capture.poses.lenses]))
        writer.attributes["distortion"] = [
            {"model": lens.model, "parameters": list(lens.parameters)} for lens in capture.poses.lenses
        ]
        if capture.poses.points is not None:
            write_points(writer, capture.poses.points)


def read_capture(artifact: Artifact) -> Capture:
    """Read a `capture` artifact; poses without the attribute `distortion` are those of pinhole cameras."""
    attributes: dict[str, Any] = dict(artifact.attributes)
    sizes = tuple((int(width), int(height)) for width, height in attributes["sizes"])
    return Capture(
        names=tuple(attributes["names"]),
        sizes=sizes,
        focal_pixels=tuple(attributes["focal_pixels"]),
        ordered=bool(attributes["ordered"]),
        poses=_read_poses(artifact, attributes, sizes),
        taken_by=tuple(attributes.get("taken_by", ())),
        test_names=tuple(attributes.get("test_names", ())),
    )


def _read_poses(
    artifact: Artifact, attributes: dict[str, Any], sizes: tuple[tuple[int, int], ...]
) -> KnownPoses | None:
    source = attributes["poses"]
    if source == "none":
        return None
    if source not in get_args(PoseSource):
        raise UserError("a capture's poses are of an unknown kind", found=source, expected=get_args(PoseSource))
    distortion: list[dict[str, Any]] | None = attributes.get("distortion")
    if distortion is None:
        matrices = artifact.read("intrinsics")
        lenses = tuple(Lens.pinhole(matrix, *size) for matrix, size in zip(matrices, sizes, strict=True))
    else:
        lenses = tuple(
            Lens(one["model"], tuple(one["parameters"]), *size) for one, size in zip(distortion, sizes, strict=True)
        )
    return KnownPoses(source, artifact.read("world_to_camera"), lenses, read_points(artifact))


def picture_path(artifact: Artifact, name: str) -> Path:
    """Path of the encoded picture `name` in a capture; `read_picture` turns it upright."""
    return artifact.file(f"{PICTURES}/{name}")


def in_order_of_numbers(names: tuple[str, ...]) -> list[int]:
    """Positions of the names, sorted by the numbers in them.

    >>> in_order_of_numbers(("frame10.png", "frame2.png", "frame1.png"))
    [2, 1, 0]
    """
    return sorted(range(len(names)), key=lambda row: _natural_key(names[row]))


def _natural_key(name: str) -> tuple[list[tuple[int, str]], str]:
    parts = re.findall(r"\d+|\D+", Path(name).stem)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts], name


def numbered(names: tuple[str, ...]) -> bool:
    """Whether most names consist of one word and a running number, as cameras and video tools write them.

    The word may contain a date. A tenth of the names may differ: phones name burst or edited photos differently.

    >>> numbered(("DSC_0001.JPG", "DSC_0002.JPG")), numbered(("left.png", "right.png")), numbered(())
    (True, False, False)
    >>> numbered(("20260101_120000.jpg", "20260102_090000.jpg")), numbered(("left1.jpg", "right1.jpg"))
    (True, False)
    """
    words = [match[1] for name in names if (match := re.fullmatch(r"(.*?)\d+", Path(name).stem))]
    counts = Counter(re.sub(r"(?<!\d)\d{8}(?!\d)", "day", word) for word in words)
    return bool(counts) and counts.most_common(1)[0][1] >= MOST_OF_A_SEQUENCE * len(names)
