"""A capture: photos as they came, and what is known of their cameras before any structure from motion."""

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
"""Where poses come from: a COLMAP model, a transforms.json, or the world that the pictures were traced from."""

PICTURES = "pictures"
MOST_OF_A_SEQUENCE = 0.9
"""At least this share of the names is alike where photos were taken in the order of their numbers."""


@dataclass(frozen=True)
class KnownPoses:
    """Poses of V photos that came with them: world to camera, looking down +z, and the lens of each.

    `points` are those that came with the poses; None where none did.
    """

    source: PoseSource
    world_to_camera: Float64[np.ndarray, "V 4 4"]
    lenses: tuple[Lens, ...]
    points: KnownPoints | None = None


@dataclass(frozen=True)
class Capture:
    """V photos, sorted by name.

    `names` are file names, `sizes` the width and height of each picture when upright, `focal_pixels` what EXIF says
    of its focal length. `ordered`: the names' numbers count in the order in which the photos were taken.
    `taken_by`: the number of the camera that took each, as far as it is known which differ; empty: nothing says so.
    `test_names`: those that the files of poses hold out for tests; empty: they say nothing of it.
    """

    names: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    focal_pixels: tuple[float | None, ...]
    ordered: bool
    poses: KnownPoses | None = None
    taken_by: tuple[int, ...] = ()
    test_names: tuple[str, ...] = ()


def write_capture(writer: ArtifactWriter, capture: Capture, picture_of: Callable[[str], bytes | Path]) -> None:
    """Write a `capture` artifact; `picture_of` a name gives its encoded bytes, or the file to copy them from.

    It is asked for one picture after another, so that no two need to be in memory.
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
    """The encoded picture `name` of a capture; `read_picture` turns it upright."""
    return artifact.file(f"{PICTURES}/{name}")


def in_order_of_numbers(names: tuple[str, ...]) -> list[int]:
    """Positions of the names in the order of the numbers in them.

    >>> in_order_of_numbers(("frame10.png", "frame2.png", "frame1.png"))
    [2, 1, 0]
    """
    return sorted(range(len(names)), key=lambda row: _natural_key(names[row]))


def _natural_key(name: str) -> tuple[list[tuple[int, str]], str]:
    parts = re.findall(r"\d+|\D+", Path(name).stem)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts], name


def numbered(names: tuple[str, ...]) -> bool:
    """Whether most names are one word and a running number, as cameras and video tools write them; the word may hold a
    day. A tenth may differ: phones call a photo of a burst, or one that was edited, otherwise.

    >>> numbered(("DSC_0001.JPG", "DSC_0002.JPG")), numbered(("left.png", "right.png")), numbered(())
    (True, False, False)
    >>> numbered(("20260101_120000.jpg", "20260102_090000.jpg")), numbered(("left1.jpg", "right1.jpg"))
    (True, False)
    """
    words = [match[1] for name in names if (match := re.fullmatch(r"(.*?)\d+", Path(name).stem))]
    counts = Counter(re.sub(r"(?<!\d)\d{8}(?!\d)", "day", word) for word in words)
    return bool(counts) and counts.most_common(1)[0][1] >= MOST_OF_A_SEQUENCE * len(names)
