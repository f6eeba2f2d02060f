"""`import_scene`: a scene's cameras and pictures, from a copy or from the folder in a store that `latest/` leads to."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from pydantic import Field

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from pipeline.stage import Context, ExternalPath, Output, Parameters, stage
from stages.scene.camera_checks import are_cameras
from stages.scene.photo_folder import refuse_unwritten_names
from stages.scene.scene import Scene, read_scene, write_scene
from stages.scene.verified_copy import damage_told, verified_copy

KIND = "scene"
FORMS = {
    "pictures": ("u1", (None, None, None, 3)),
    "world_to_camera": ("f8", (None, 4, 4)),
    "intrinsics": ("f8", (None, 3, 3)),
    "points": ("f4", (None, 3)),
    "point_colors": ("u1", (None, 3)),
}
"""Type and shape of each array; None stands for any size."""
ARGUMENTS = ("writer", "scene")
"""Names of arguments of `write_scene` that are not facts of a scene."""
LARGEST = 2**34
"""Largest size of all arrays in bytes: a file may decompress into far more than its own size."""
LISTED = 5  # views named in an error
REMEDY = "give the folder to which `export` copied a scene, such as hide_photos/cover_scene.scene, unpacked if zipped"


class ImportSceneParameters(Parameters):
    """Where the scene is."""

    folder: ExternalPath = Field(
        description="Folder of a scene, as copied by the command `export` or as found in a store."
    )


@stage(inputs={}, outputs={"scene": Output(KIND)}, version=1)
def import_scene(context: Context, parameters: ImportSceneParameters) -> None:
    """Check every byte, and write the scene unchanged: as the same artifact again, if it was public.

    The cameras are in the world of the container that was trained from them; structure from motion would not find that
    world again from other photos, nor in another version. Raises `UserError` if the scene is missing, broken or
    malformed, or is private and would become public.
    """
    copy = verified_copy(parameters.folder, KIND, REMEDY)
    _check_form(copy)
    with damage_told(parameters.folder, KIND, REMEDY):
        scene = read_scene(copy)
    if copy.private and not context.output("scene").private:
        raise UserError(
            "a private scene would become public",
            where=parameters.folder,
            remedy="write `private: true` into the stage's entry in the workflow",
        )
    _check_views(copy, scene)
    facts = {
        name: value
        for name, value in copy.attributes.items()
        if isinstance(value, str | int | float | None) and name not in ARGUMENTS
    }
    write_scene(context.output("scene"), scene, **facts)
    context.record(views=len(scene.cameras))


def _check_form(copy: Artifact) -> None:
    """Check types and shapes before any array is decompressed. Raises `UserError` if they are not a scene's."""
    records = copy.manifest.arrays
    for name, (kind, shape) in FORMS.items():
        record = records.get(name)
        if record is None or record.dtype[1:] != kind or not _fits(record.shape, shape):
            found = "nothing" if record is None else f"{record.dtype} {list(record.shape)}"
            raise UserError(
                f"the scene's {name} are missing or of the wrong type or shape",
                where=copy.path,
                found=found,
                expected=f"{kind} {shape}",
            )
    size = sum(math.prod(records[name].shape) * np.dtype(kind).itemsize for name, (kind, _) in FORMS.items())
    if size > LARGEST:
        raise UserError("the scene is too large", where=copy.path, found=f"{size} bytes", expected=f"at most {LARGEST}")


def _fits(found: Sequence[int], expected: Sequence[int | None]) -> bool:
    return len(found) == len(expected) and all(
        size in (None, there) for size, there in zip(expected, found, strict=True)
    )


def _check_views(copy: Artifact, scene: Scene) -> None:
    names = scene.cameras.names
    wrong = (
        len(scene.pictures) != len(names) or len(scene.points) != len(scene.point_colors) or 0 in scene.pictures.shape
    )
    if not names or wrong or len(set(names)) != len(names) or not set(scene.test_names) <= set(names):
        raise UserError(
            "the scene's parts do not match",
            where=copy.path,
            found=f"{len(names)} views, {len(scene.pictures)} pictures, {len(scene.points)} points and "
            f"{len(scene.point_colors)} point colours",
            expected="a picture for each view, at least one, test views among them, and a colour for each point",
        )
    refuse_unwritten_names(copy.path, names)
    strange = [name for name, good in zip(names, are_cameras(scene.cameras), strict=True) if not good]
    if strange or not np.isfinite(scene.points).all():
        raise UserError(
            "the scene has invalid cameras or points",
            where=copy.path,
            found=f"invalid cameras for {', '.join(strange[:LISTED])}"
            if strange
            else "NaN or infinity among the points",
            expected="focal lengths above 0, valid rotations, and finite positions",
            remedy=REMEDY,
        )
