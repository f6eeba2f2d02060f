"""`photos`: a capture from a folder of photos, with the poses that came with them, if any."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.stage import Context, ExternalPath, Output, Parameters, stage
from stages.scene.capture import Capture, numbered, write_capture
from stages.scene.photo_folder import find_photos, find_poses, known_poses, read_facts, read_poses


class PhotosParameters(Parameters):
    """Where the photos are."""

    folder: ExternalPath = Field(
        description="Folder of photos; a COLMAP model (sparse/0) or a transforms.json in it is used for the poses."
    )
    poses: ExternalPath | None = Field(
        None, description="COLMAP model's folder or transforms.json, where the poses lie outside the folder of photos."
    )
    order: Literal["auto", "ordered", "unordered"] = Field(
        "auto",
        description="Whether the numbers in the names follow the order of taking; auto: where all names share a word.",
    )


@stage(inputs={}, outputs={"capture": Output("capture")}, version=1)
def photos(context: Context, parameters: PhotosParameters) -> None:
    """Read every photo once, so that damage shows here, and keep them as they came."""
    found = find_photos(parameters.folder)
    facts = {}
    for count, (name, path) in enumerate(found.photos.items(), start=1):
        facts[name] = read_facts(path)
        context.progress(count, len(found.photos))
        context.stop_if_requested()
    place = parameters.poses or find_poses(parameters.folder)
    poses, names = None, tuple(found.photos)
    if place is not None:
        source, posed = read_poses(place, {name: one.size for name, one in facts.items()})
        poses, names = known_poses(source, posed), tuple(photo.name for photo in posed)
        context.log(
            f"poses of {len(names)} photos from {place.name}; {len(facts) - len(names)} photos have none, left out"
        )
    if found.ignored:
        context.log(f"{found.ignored} files beside the photos are no photos and were ignored")
    capture = Capture(
        names=names,
        sizes=tuple(facts[name].size for name in names),
        focal_pixels=tuple(facts[name].focal_pixels for name in names),
        ordered=numbered(names) if parameters.order == "auto" else parameters.order == "ordered",
        poses=poses,
    )
    write_capture(context.output("capture"), capture, {name: found.photos[name] for name in names})
    context.record(photos=len(names), ignored_files=found.ignored, without_pose=len(facts) - len(names))
