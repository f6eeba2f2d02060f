"""A scene: posed pinhole pictures at training size, the sparse points, and which views are held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

from pipeline.artifact import Artifact, ArtifactWriter
from stages.scene.attributes import strings
from stages.scene.cameras import Cameras

TEST_VIEW_EVERY = 8
"""Every 8th registered name, in sorted order, is a test view: the convention of Mip-NeRF 360 and 3DGS."""


@dataclass(frozen=True)
class Scene:
    """The result of structure from motion: V pictures of one size, their cameras, and P sparse points.

    Points are in world coordinates; colours are sRGB bytes. `test_names` are the views that no training may see.
    """

    cameras: Cameras
    pictures: UInt8[np.ndarray, "V H W 3"]
    points: Float32[np.ndarray, "P 3"]
    point_colors: UInt8[np.ndarray, "P 3"]
    test_names: tuple[str, ...]

    @property
    def train_names(self) -> tuple[str, ...]:
        """The names of the views that are not held out, in the cameras' order; empty if all are."""
        held_out = set(self.test_names)
        return tuple(name for name in self.cameras.names if name not in held_out)

    @property
    def training_cameras(self) -> Cameras:
        """The cameras of the training views, or all cameras if every view is held out."""
        return self.cameras.select(self.train_names or self.cameras.names)

    def rows(self, names: Sequence[str]) -> list[int]:
        """Positions of the named views among `cameras` and `pictures`. Raises `KeyError` for an unknown name."""
        index = {name: row for row, name in enumerate(self.cameras.names)}
        return [index[name] for name in names]


def held_out_by_number(names: Sequence[str]) -> tuple[str, ...]:
    """The test views among registered `names`: every 8th in sorted order, beginning with the first."""
    return tuple(sorted(names)[::TEST_VIEW_EVERY])


def read_scene(artifact: Artifact) -> Scene:
    """Read a `scene` artifact."""
    pictures = artifact.read("pictures")
    cameras = Cameras(
        names=strings(artifact, "names"),
        world_to_camera=artifact.read("world_to_camera"),
        intrinsics=artifact.read("intrinsics"),
        width=pictures.shape[2],
        height=pictures.shape[1],
    )
    return Scene(
        cameras,
        pictures,
        artifact.read("points"),
        artifact.read("point_colors"),
        strings(artifact, "test_names"),
    )


def write_scene(writer: ArtifactWriter, scene: Scene, **attributes: str | int | float | None) -> None:
    """Write a `scene` artifact; `attributes` (registered, total, …) are stored beside the names."""
    writer.write("pictures", scene.pictures)
    writer.write("world_to_camera", scene.cameras.world_to_camera)
    writer.write("intrinsics", scene.cameras.intrinsics)
    writer.write("points", scene.points)
    writer.write("point_colors", scene.point_colors)
    writer.attributes |= {"names": [*scene.cameras.names], "test_names": [*scene.test_names], **attributes}
