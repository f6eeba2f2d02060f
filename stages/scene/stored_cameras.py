"""Cameras stored without pictures: viewpoints from which something may be looked at."""

from __future__ import annotations

from pipeline.artifact import Artifact, ArtifactWriter
from stages.scene.attributes import mapping, strings
from stages.scene.cameras import Cameras

KIND = "cameras"
SIZE = "size"


def write_cameras(writer: ArtifactWriter, cameras: Cameras | None) -> None:
    """Write a `cameras` artifact; None if no cameras are known."""
    writer.attributes["names"] = [*cameras.names] if cameras else []
    if cameras:
        writer.write("world_to_camera", cameras.world_to_camera)
        writer.write("intrinsics", cameras.intrinsics)
        writer.attributes[SIZE] = {"width": cameras.width, "height": cameras.height}


def read_cameras(artifact: Artifact) -> Cameras | None:
    """Read a `cameras` artifact; None if it has no cameras."""
    names = strings(artifact, "names")
    if not names:
        return None
    width, height = (int(str(mapping(artifact, SIZE)[side])) for side in ("width", "height"))
    return Cameras(names, artifact.read("world_to_camera"), artifact.read("intrinsics"), width, height)
