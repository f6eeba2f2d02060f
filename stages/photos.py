"""`photos`: a capture from a folder of photos, with the poses that came with them, if any."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field

from pipeline.errors import UserError
from pipeline.stage import Context, ExternalPath, Output, Parameters, stage
from stages.imaging.backgrounds import over_background
from stages.imaging.orientation import SIDEWAYS, UPRIGHT, as_stored
from stages.imaging.pictures import encode_png, read_picture
from stages.scene.camera_checks import refuse_far_poses
from stages.scene.capture import Capture, KnownPoses, numbered, write_capture
from stages.scene.colmap import models_beside, photos_in_model
from stages.scene.given_poses import find_poses, known_points, known_poses, poses_at, read_poses
from stages.scene.held_out import held_out_photos
from stages.scene.named_frames import find_posed_photos
from stages.scene.photo_facts import PhotoFacts, as_posed, read_facts, taken_by
from stages.scene.photo_folder import (
    ANIMATIONS,
    SUFFIXES,
    PhotoFolder,
    copies_among,
    files_not_among,
    find_photos,
    refuse_unread,
)
from stages.scene.picture_folder import find_pictures
from stages.scene.plurals import agreeing, counted
from stages.scene.splits import TEST, find_split_photos, find_splits, read_split_poses
from stages.scene.transforms import FILE, masked_frames
from stages.scene.unreadable import write_unreadable_names

WHITE = "white"
"""The background that `read_picture` lays transparent pictures over."""

MOST_NAMED = 10
"""Largest number of files named in a line of the log."""


class PhotosParameters(Parameters):
    """Where photos and poses are, and how they are read."""

    folder: ExternalPath = Field(
        description="Folder of photos. Poses are taken from a COLMAP model (sparse/0), a transforms.json or a "
        "transforms_train.json in it; points from the model, or from the PLY that a transforms.json names."
    )
    images: str | None = Field(
        None,
        pattern=r"^[^/\\.][^/\\]*$",
        description="Subfolder of `folder` that holds the photos, such as images_4: Mip-NeRF 360 comes in several "
        "sizes. 3DGS trains at a quarter of the size outdoors (images_4) and at half of it indoors (images_2). "
        "By default, the photos in `folder` itself, or those in images if it has more, else those in subfolders of "
        "images. Not allowed with a transforms_train.json, whose frames name their photos.",
    )
    poses: ExternalPath | None = Field(
        None,
        description="Folder of a COLMAP model, or a transforms.json, if the poses are not in the folder of photos.",
    )
    background: str = Field(
        "black",
        pattern=r"^(white|black|gray|#[0-9a-fA-F]{6})$",
        description="Background colour for transparent pictures, such as NeRF's synthetic scenes rendered by Blender. "
        "Black by default, as in 3DGS, because training and rendering use black: any other colour would have to be "
        "built from Gaussians in empty space around the object. NeRF's tables use white.",
    )
    any_pictures: bool = Field(
        False,
        description="Whether the folder holds arbitrary pictures to search rather than a capture. Only pictures "
        "directly in it are read (of GIFs, the first frame), without poses. Unreadable ones are named and left out, "
        "as long as one is readable. The log counts the files in the folder and its subfolders that were not looked "
        "at.",
    )
    own_photos: ExternalPath | None = Field(
        None,
        description="With any_pictures, the folder of your own photos. If `folder` is the same, no pictures were "
        "given, and your own photos are searched instead.",
    )
    order: Literal["auto", "ordered", "unordered"] = Field(
        "auto",
        description="Whether file numbers follow the order in which photos were taken; auto: yes if all names share a "
        "word.",
    )


@stage(
    inputs={},
    outputs={"capture": Output("capture")},
    version=1,
    remarks="stages.scene.remarks:photos_left_out",
)
def photos(context: Context, parameters: PhotosParameters) -> None:
    """Decode every photo once, so that damage shows here, and store them as they came.

    All photos of a capture must be readable. Without poses, copies of a photo are left out: if one became a training
    view and the other a test view, the test view would not be new. With `any_pictures`, which strangers may have made,
    one unreadable picture must not withhold the verdicts on all others: it is left out, and the capture records its
    name (`unreadable_names`).
    """
    found, place, splits = _found(parameters)
    posed = place is not None or bool(splits)
    facts, broken = facts_of(context, found, posed)
    if broken and (posed or not parameters.any_pictures or not facts):
        raise _of_all(broken)
    copies = [] if posed or parameters.any_pictures else copies_among({name: found.photos[name] for name in facts})
    for name in copies:
        del facts[name]
    poses, names, missing = _poses(context, parameters, place, splits, facts)
    if poses is not None:
        facts |= {name: as_posed(facts[name], lens) for name, lens in zip(names, poses.lenses, strict=True)}
    own = parameters.any_pictures and _are_own(parameters)
    if own:
        context.log(agreeing(len(names), f"no pictures given: your own {len(names)} photo[s] [is|are] tried"))
    unseen = files_not_among({*found.photos.values()}, parameters.folder) if parameters.any_pictures and not own else []
    _say_what_was_left_out(context, found, copies, unseen, broken, parameters.folder)
    test_names = _held_out_names(parameters, place, splits, names, facts, missing)
    capture = _capture(names, facts, found.photos, poses, test_names, parameters.order)
    _say_what_was_kept(context, capture, facts)
    places = {name: place for place, name in enumerate(names)}

    def kept(name: str) -> Path | bytes:
        context.progress_or_stop(len(found.photos) + places[name], len(found.photos) + len(names))
        return picture_of(found.photos[name], parameters.background, facts[name].turned)

    write_capture(context.output("capture"), capture, kept)
    write_unreadable_names(context.output("capture"), broken)
    context.record(
        photos=len(names),
        ignored_files=found.ignored,
        without_pose=len(facts) - len(names),
        left_out=len(found.left_out),
        unread=dict(found.unread),
        unreadable=list(broken),
        not_looked_at=len(unseen),
        own_photos=own,
        below=len(found.below),
        copies=len(copies),
        masked=sum(masked_frames(file) for file in _files_with_frames(parameters.folder, place, splits)),
    )


def _found(parameters: PhotosParameters) -> tuple[PhotoFolder, Path | None, Mapping[str, Path]]:
    """Find the photos, and the source of their poses: a model or a file, or the file of each split.

    Pictures of any kind have no poses, unless they are the owner's own photos.
    """
    folder = parameters.folder
    if parameters.any_pictures and not _are_own(parameters):
        return find_pictures(folder, (*SUFFIXES, *ANIMATIONS)), None, {}
    place = find_poses(folder) if parameters.poses is None else poses_at(parameters.poses)
    splits = find_splits(folder) if place is None else {}
    _refuse_images(parameters, splits)
    if splits:
        return find_split_photos(folder, splits), place, splits
    if place == folder / FILE and parameters.images is None:
        return find_posed_photos(folder, place), place, splits
    found = find_photos(folder, parameters.images)
    if place is None and not parameters.any_pictures:
        refuse_unread(folder, found)
    return found, place, splits


def _files_with_frames(folder: Path, place: Path | None, splits: Mapping[str, Path]) -> list[Path]:
    """The files that name photos frame by frame; nerfstudio leaves one beside a COLMAP model, too."""
    if place is None:
        return [*splits.values()]
    beside = folder / FILE
    return ([beside] if beside.is_file() else []) if place.is_dir() else [place]


def _are_own(parameters: PhotosParameters) -> bool:
    """Whether the folder is that of the owner's own photos, because no other pictures were given."""
    own = parameters.own_photos
    return own is not None and parameters.folder.resolve() == own.resolve()


def _poses(
    context: Context,
    parameters: PhotosParameters,
    place: Path | None,
    splits: Mapping[str, Path],
    facts: Mapping[str, PhotoFacts],
) -> tuple[KnownPoses | None, tuple[str, ...], list[str]]:
    """The poses that came with the photos, the names of the photos with poses, and those of posed photos not there.

    Without poses, None, the names of all photos, and no others.
    """
    if place is None and not splits:
        return None, tuple(facts), []
    sizes = {name: one.size for name, one in facts.items()}
    resized = parameters.images is not None
    sideways = {name for name, one in facts.items() if one.turned in SIDEWAYS}
    read = read_poses(place, sizes, resized, sideways) if place is not None else read_split_poses(splits, sizes)
    source, posed, missing = read
    points = None if place is None else known_points(place, posed, parameters.folder)
    poses, names = known_poses(source, posed, points), tuple(photo.name for photo in posed)
    refuse_far_poses(poses.world_to_camera, place or parameters.folder)
    came = " and ".join(file.name for file in ([place] if place is not None else splits.values()))
    without = len(facts) - len(names)
    left_out = agreeing(without, f"{without} photo[s] without a pose left out")
    context.log(f"poses of {counted(len(names), 'photo')} from {came}; {left_out}")
    context.record(without_photo=len(missing))
    if missing:
        are_not_there = agreeing(len(missing), "pose[s] [belongs|belong] to [a missing photo|missing photos]")
        context.log(f"{len(missing)} {are_not_there}, left out, such as {', '.join(missing[:MOST_NAMED])}")
    if points is not None:
        context.log(f"{len(points.positions)} points came with the poses")
    for other in [] if place is None else models_beside(place):
        context.log(
            f"model {other.name} beside it has poses of {counted(photos_in_model(other), 'photo')} and was not used"
        )
    return poses, names, missing


def _capture(
    names: tuple[str, ...],
    facts: Mapping[str, PhotoFacts],
    files: Mapping[str, Path],
    poses: KnownPoses | None,
    test_names: tuple[str, ...],
    order: str,
) -> Capture:
    return Capture(
        names=names,
        sizes=tuple(facts[name].size for name in names),
        focal_pixels=tuple(facts[name].focal_pixels for name in names),
        ordered=numbered(names) if order == "auto" else order == "ordered",
        poses=poses,
        taken_by=taken_by({name: files[name] for name in names}, facts),
        test_names=test_names,
    )


def _say_what_was_kept(context: Context, capture: Capture, facts: Mapping[str, PhotoFacts]) -> None:
    """Which photos EXIF would rotate, and which are test views."""
    turned, held_out = sum(facts[name].turned != UPRIGHT for name in capture.names), len(capture.test_names)
    if turned:
        lie = f"{turned} photo[s] [is|are] kept as stored, which the poses refer to"
        context.log(agreeing(turned, f"{lie}; EXIF would rotate [it|them]"))
    if held_out:
        context.log(
            agreeing(held_out, f"{held_out} photo[s] [is a test view|are test views] according to the pose files")
        )


def _say_what_was_left_out(
    context: Context,
    found: PhotoFolder,
    copies: Sequence[str],
    unseen: Sequence[Path],
    broken: Mapping[str, UserError],
    folder: Path,
) -> None:
    if found.left_out:
        count = len(found.left_out)
        lie = agreeing(count, f"{count} photo[s] [is|are] in another folder and [was|were] left out")
        context.log(f"{lie}; the first is {found.left_out[0]}")
    if found.below:
        folders = dict.fromkeys(photo.parent.relative_to(folder).as_posix() for photo in found.below)
        listed = ", ".join([*folders][:MOST_NAMED])
        count = len(found.below)
        lie = agreeing(count, f"{count} photo[s] [is|are] in folders beside those used and [was|were] left out")
        context.log(f"{lie}: in {listed}")
    if copies:
        count = len(copies)
        are = agreeing(count, f"{count} photo[s] [is an exact copy of another|are exact copies of others]")
        context.log(f"{are}, left out: {', '.join(copies)}")
    if found.ignored:
        count = found.ignored
        context.log(
            agreeing(count, f"{count} file[s] beside the photos [is no photo and was|are no photos and were] ignored")
        )
    if unseen:
        listed = ", ".join(file.relative_to(folder).as_posix() for file in unseen[:MOST_NAMED])
        count = len(unseen)
        files = agreeing(count, f"{count} file[s] in the folder and its subfolders [was|were] not looked at")
        context.log(f"{files}, such as {listed}")
    for name, error in broken.items():
        context.log(f"{name} is left out: {error}")


def _refuse_images(parameters: PhotosParameters, splits: Mapping[str, Path]) -> None:
    if splits and parameters.images is not None:
        raise UserError(
            "images cannot be given: the pose files name the photos of each split",
            where=parameters.folder,
            found=f"images: {parameters.images}, and {' and '.join(file.name for file in splits.values())}",
            expected="no parameter images",
            remedy="Leave images out, or move those files out of the folder to have the poses estimated.",
        )


def facts_of(context: Context, found: PhotoFolder, posed: bool) -> tuple[dict[str, PhotoFacts], dict[str, UserError]]:
    """Read the facts of every photo, by name, and the errors of those that cannot be read.

    This counts as half of the progress; copying the photos is the other half.
    """
    facts: dict[str, PhotoFacts] = {}
    broken: dict[str, UserError] = {}
    for count, (name, path) in enumerate(found.photos.items(), start=1):
        try:
            facts[name] = read_facts(path, posed)
        except UserError as error:
            broken[name] = error
        context.progress_or_stop(count, 2 * len(found.photos))
    return facts, broken


def _of_all(broken: Mapping[str, UserError]) -> UserError:
    """A single error that names all unreadable photos, of which there must be at least one."""
    errors = [*broken.values()]
    if len(errors) == 1:
        return errors[0]
    named = ", ".join(Path(str(error.where)).name for error in errors[:MOST_NAMED])
    return UserError(
        f"{len(errors)} pictures cannot be read",
        where=Path(str(errors[0].where)).parent,
        found=f"{named}{', …' if len(errors) > MOST_NAMED else ''}; of the first: {errors[0].found}",
        expected=errors[0].expected,
        remedy="Replace these files, or take them out of the folder.",
    )


def picture_of(path: Path, background: str, turned: int) -> Path | bytes:
    """The photo's own file; a PNG if readers would lay it over another background, or rotate it by EXIF."""
    picture = None if background == WHITE else over_background(path, background)
    if turned != UPRIGHT:
        picture = as_stored(read_picture(path) if picture is None else picture, turned)
    return path if picture is None else encode_png(picture)


def _held_out_names(
    parameters: PhotosParameters,
    place: Path | None,
    splits: Mapping[str, Path],
    names: Sequence[str],
    photos: Collection[str],
    missing: Collection[str],
) -> tuple[str, ...]:
    """Those of the `names` that the files with poses, or beside them, hold out for testing; empty if none are."""
    if splits:
        return tuple(name for name in names if name.startswith(f"{TEST}_"))
    if place is None:
        return ()
    given = [parameters.poses] if parameters.poses is not None and parameters.poses.is_dir() else []
    held_out = held_out_photos(place, [*given, parameters.folder], photos, missing)
    return tuple(name for name in names if name in held_out)
