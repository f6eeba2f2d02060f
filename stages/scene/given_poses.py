"""Poses and points that came with a capture: where they are, and which photo each belongs to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from unicodedata import normalize

import numpy as np

from pipeline.errors import UserError
from pipeline.plain_text import in_a_line
from stages.scene.capture import KnownPoses, PoseSource
from stages.scene.colmap import PosedPhoto, find_colmap_model, read_colmap_model
from stages.scene.colmap_points import PART, points_seen_by, read_colmap_points
from stages.scene.known_points import KnownPoints
from stages.scene.lens import Lens
from stages.scene.photo_folder import what_is_there
from stages.scene.ply_points import points_of_ply, points_of_transforms, seen_by_projection
from stages.scene.transforms import FILE, read_transforms

ASPECT_TOLERANCE = 0.01
MOST = 0.7
"""Fraction of the posed photos that must be present: a model with fewer of them belongs to other photos."""
LONGEST_PATH = 4096
"""Characters, Linux's limit; anything longer in a file of poses is not a photo's path."""


def poses_at(place: Path) -> Path:
    """`place` itself, or what `find_poses` finds in it if it is a folder. Raises `UserError` if that is nothing."""
    found = find_poses(place) if place.is_dir() else place
    if found is None:
        raise UserError(
            "a folder without poses",
            where=place,
            found=what_is_there(place),
            expected=f"a COLMAP model (cameras and images, .bin or .txt) or a {FILE}",
        )
    return found


def find_poses(folder: Path) -> Path | None:
    """The folder of a capture's COLMAP model, or else its `transforms.json`; None if it has neither."""
    model = find_colmap_model(folder)
    if model is None and (folder / FILE).is_file():
        return folder / FILE
    return model


def photo_finder(photos: Collection[str], place: Path) -> Callable[[str], str | None]:
    """A function that finds the photo that a path in the file of poses at `place` refers to, or None.

    It matches the file name, else the stem. For photos from several folders, it also matches the folders before the
    name. Accented letters may be composed or decomposed. It takes time proportional to the path, and raises `UserError`
    for one that is too long for any photo.

    >>> find = photo_finder(["left_1.jpg", "right_1.jpg", "2.png"], Path("transforms.json"))
    >>> find("images/left/1.jpg"), find("right/1"), find("images/2.jpg"), find("1.jpg")
    ('left_1.jpg', 'right_1.jpg', '2.png', None)
    """
    named = {normalize("NFC", name): name for name in photos} | {name: name for name in photos}
    stems = {Path(written).stem: name for written, name in named.items()}
    most_parts = 1 + max((name.count("_") for name in photos), default=0)  # a name has an underscore for each folder

    def find(path: str) -> str | None:
        if len(path) > LONGEST_PATH:
            raise UserError(
                "the path of a photo is too long",
                where=place,
                found=f"{in_a_line(path, 60)}, of {len(path)} characters",
                expected=f"at most {LONGEST_PATH} characters",
                remedy="Repair the file of poses, or take it out of the folder to have the poses estimated.",
            )
        for written in dict.fromkeys((path, normalize("NFC", path))):
            parts = Path(written).parts[-most_parts:]
            names = ("_".join(parts[start:]) for start in range(len(parts)))
            found = (named.get(name) or stems.get(name) or stems.get(Path(name).stem) for name in names)
            if photo := next(filter(None, found), None):
                return photo
        return None

    return find


def read_poses(
    place: Path, sizes: Mapping[str, tuple[int, int]], resized: bool = False, sideways: Collection[str] = ()
) -> tuple[PoseSource, list[PosedPhoto], list[str]]:
    """Read a COLMAP model or a transforms.json: its kind, the poses of the photos in `sizes`, and the missing photos.

    Poses are renamed to the photos, which `photo_finder` matches, and sorted by name. Posed photos that are missing are
    left out, since somebody deleted them, and listed by their names in the file. Each lens is scaled to its photo's
    size; `resized` states that photos differ in size from those that were posed. `sideways` are the photos that EXIF
    turns by a quarter, and whose sizes are those of the stored pixels: a lens that only fits one turned gets that size.
    Raises `UserError` for unreadable files, paths that are too long, photos posed twice, other aspect ratios, and if
    less than `MOST` of the posed photos are present.
    """
    photo_named = photo_finder(sizes, place)

    def size_of(name: str) -> tuple[int, int]:
        photo = photo_named(name)
        return sizes[photo] if photo is not None else (1, 1)

    source: PoseSource = "colmap" if place.is_dir() else "transforms"
    posed = read_colmap_model(place) if place.is_dir() else read_transforms(place, size_of, resized=resized)
    matched = {each.name: photo_named(each.name) for each in posed}
    missing = [name for name, photo in matched.items() if photo is None]
    if len(missing) > (1 - MOST) * len(matched) or not posed:
        raise UserError(
            "the poses refer to photos that do not exist" if posed else "a file of poses without poses",
            where=place,
            found=f"{len(missing)} of {len(posed)}: {', '.join(missing[:3])}" if posed else "0 photos",
            expected=f"the names of the {len(sizes)} photos, such as {min(sizes)}" if sizes else "frames",
            remedy="Put the photos there, or take the poses out of the folder to have them estimated. Few that are "
            "missing would be left out.",
        )
    renamed = [replace(each, name=photo) for each in posed if (photo := matched[each.name]) is not None]
    name, times = Counter(each.name for each in renamed).most_common(1)[0]
    if times > 1:
        raise UserError(f"photo {name} is posed twice", where=place, remedy="Keep one pose for every photo.")
    fitted = [replace(each, lens=_fitted(place, each, sizes[each.name], each.name in sideways)) for each in renamed]
    return source, sorted(fitted, key=lambda photo: photo.name), missing


def _fitted(place: Path, photo: PosedPhoto, size: tuple[int, int], is_sideways: bool) -> Lens:
    lens = photo.lens
    for width, height in (size, size[::-1]) if is_sideways else (size,):
        if abs(lens.width / lens.height / (width / height) - 1) <= ASPECT_TOLERANCE:
            return lens.resized(width, height)
    raise UserError(
        f"the poses are for a photo {photo.name} of another shape",
        where=place,
        found=f"{lens.width} x {lens.height} pixels",
        expected=f"{size[0]} x {size[1]} pixels, or the same proportions",
        remedy="Use the photos that the poses were made from, neither cropped nor turned.",
    )


def known_poses(source: PoseSource, posed: Sequence[PosedPhoto], points: KnownPoints | None = None) -> KnownPoses:
    """The poses of these photos, in this order."""
    poses = np.stack([photo.world_to_camera for photo in posed])
    return KnownPoses(source, poses, tuple(photo.lens for photo in posed), points)


def known_points(place: Path, posed: Sequence[PosedPhoto], folder: Path) -> KnownPoints | None:
    """The points that came with the poses at `place`; None if there are none.

    Of a COLMAP model, those that the `posed` photos see, or all in a points3D.ply if it has no other file of points;
    of a transforms.json, those it names within `folder`. Raises `UserError` for points that cannot be read, and if two
    photos share an image id.
    """
    if not place.is_dir():
        return points_of_transforms(place, posed, folder)
    points = read_colmap_points(place)
    if points is None:
        ply = place / f"{PART}.ply"
        return points_of_ply(ply, posed) if ply.is_file() else None
    numbers = [photo.number for photo in posed if photo.number is not None]
    number, times = Counter(numbers).most_common(1)[0]
    if times > 1:
        raise UserError(
            f"{times} photos of a COLMAP model have the number {number}",
            where=place,
            expected="a number for each photo, by which the model's points name those that see them",
            remedy="Export the model again, or take its points out of the folder to have them triangulated anew.",
        )
    return points_seen_by(points, numbers, partial(seen_by_projection, posed))
