"""A folder of photos: which files are pictures, what EXIF says of them, and which poses came with them."""

from __future__ import annotations

import math
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from unicodedata import normalize

import numpy as np
from PIL import Image

from pipeline.errors import UserError
from pipeline.plain_text import in_a_line
from stages.imaging.names import LONGEST_NAME, can_be_written
from stages.imaging.orientation import BROKEN_EXIF, SIDEWAYS, UPRIGHT, orientation_of
from stages.imaging.pictures import open_picture, read_picture
from stages.scene.capture import KnownPoses, PoseSource
from stages.scene.colmap import PosedPhoto, find_colmap_model, read_colmap_model
from stages.scene.lens import Lens
from stages.scene.transforms import FILE, read_transforms

SUFFIXES = (".jpg", ".jpeg", ".jfif", ".png", ".webp", ".bmp", ".tif", ".tiff")
ANIMATIONS = (".gif",)
"""No photos, but for whoever looks through pictures of any kind."""
OTHER_PICTURES = (".heic", ".heif", ".avif", ".jxl", ".gif", ".dng", ".cr2", ".cr3", ".nef", ".arw")
"""What phones and cameras write, and is no photo here."""
SUBFOLDERS = ("images", "input", "photos", "rgb")
"""Where captures keep their pictures when they do not lie in the folder itself."""

EXIF_FOLDER, FOCAL_LENGTH_IN_35MM, FOCAL_LENGTH, MAKER, MODEL = 0x8769, 0xA405, 0x920A, 0x010F, 0x0110
DIAGONAL_OF_35MM = math.hypot(36, 24)
ASPECT_TOLERANCE = 0.01
LARGEST_SIDE = 1_000_000
LONGEST_FILE_NAME = 255
"""Bytes, of most file systems."""
LONGEST_PATH = 4096
"""Characters, as Linux has it: what is longer in a file of poses is none of a photo."""


@dataclass(frozen=True)
class PhotoFolder:
    """The photos of a folder by file name, sorted, and how many other files lie beside them.

    `unread`: how many of these are pictures that are not read, by suffix, but those whose photo is there as well.
    `left_out`: photos that lie in another place where they could have been looked for, such as a preview beside images.
    `below`: how many lie in the folders beside the photos, where they outnumber these: of a rig with a few strays, most
    likely, while depths and masks are as many as the photos.
    """

    photos: dict[str, Path]
    ignored: int
    left_out: tuple[Path, ...] = ()
    unread: Mapping[str, int] = field(default_factory=dict)
    below: int = 0


@dataclass(frozen=True)
class PhotoFacts:
    """Width and height, and the focal length in pixels where EXIF tells it.

    `turned` is EXIF's orientation where they are of the pixels as stored, from which a viewer would turn them.
    `camera` is what EXIF says of what took it: maker, model, and how far its lens was zoomed; empty where it is silent.
    """

    size: tuple[int, int]
    focal_pixels: float | None
    turned: int = UPRIGHT
    camera: str = ""


def find_photos(folder: Path, images: str | None = None, suffixes: Sequence[str] = SUFFIXES) -> PhotoFolder:
    """The photos of `folder`, or of the first of its `SUBFOLDERS` with any where that has more than it has itself.

    Where neither has any, those in the folders below one of the `SUBFOLDERS`, at any depth: of the cameras of a rig, or
    of a phone. The folders are then in the names: `left/0001.jpg` is `left_0001.jpg`. With `images`, all of this of the
    folder of that name alone. Raises `UserError` where there is no folder or no photo, for names that tables cannot
    hold, and for photos that only their extensions tell apart: results are paired by name.
    """
    if not folder.is_dir():
        raise UserError("no such folder of photos", where=folder, found="a file" if folder.exists() else "nothing")
    if images is not None and not (folder / images).is_dir():
        raise UserError(
            f"a capture without a folder {images}",
            where=folder,
            found=_what_is_there(folder),
            expected="a folder of that name (parameter images)",
        )
    own = [folder / name for name in (SUBFOLDERS if images is None else (images,)) if (folder / name).is_dir()]
    inside = next(((place, photos) for place in own if (photos := _photos_in(place, suffixes))), (folder, []))
    beside = (folder, _photos_in(folder, suffixes) if images is None else [])
    (place, photos), (_, left_out) = (beside, inside) if len(beside[1]) >= len(inside[1]) else (inside, beside)
    if photos:
        files = [file for file in place.iterdir() if file.is_file()]
        below = _photos_below(place, suffixes, {*left_out})
        return PhotoFolder(
            named_photos(place, photos),
            len(files) - len(photos),
            tuple(left_out),
            _unread(files, photos),
            below if below > len(photos) else 0,
        )
    for place in own:
        files = _files_below(place)
        photos = [file for file in files if _is_photo(file, suffixes)]
        if photos:
            return PhotoFolder(named_photos(place, photos), len(files) - len(photos), unread=_unread(files, photos))
    searched = images or f"it or in its folder {', '.join(SUBFOLDERS)}"
    raise UserError(
        "a folder without photos",
        where=folder,
        found=_what_is_there(folder),
        expected=f"photos ({', '.join(suffixes)}) in {searched}",
        remedy=_how_to_have_photos([*folder.iterdir(), *(file for place in own for file in _files_below(place))]),
    )


def find_pictures(folder: Path, suffixes: Sequence[str]) -> PhotoFolder:
    """The pictures directly in a folder, each for itself, so that only their extensions may tell them apart.

    There may be none, or no folder. Raises `UserError` for names that tables cannot hold.
    """
    files = [file for file in folder.iterdir() if file.is_file()] if folder.is_dir() else []
    pictures = sorted(file for file in files if _is_photo(file, suffixes))
    refuse_unwritten_names(folder, [picture.name for picture in pictures])
    named = {picture.name: picture for picture in pictures}
    return PhotoFolder(named, len(files) - len(pictures), unread=_unread(files, pictures))


def _how_to_have_photos(found: Sequence[Path]) -> str:
    unread = _unread(found, ())
    convert = f"Convert the pictures ({', '.join(unread)}), which cannot be read, to JPEG. " if unread else ""
    if unread and not any(entry.is_dir() for entry in found):
        return convert.strip()
    return (
        f"{convert}Those of several folders, such as the cameras of a rig, are taken if the folders lie in one called "
        f"{SUBFOLDERS[0]}; of one of them alone if the parameter images names it."
    )


def _unread(files: Iterable[Path], photos: Iterable[Path]) -> dict[str, int]:
    """How many of the files are pictures that are not read, by suffix; a camera may write each beside its photo."""
    read = {photo.with_suffix("") for photo in photos}
    unread = [file for file in files if file.suffix.lower() in OTHER_PICTURES and not file.name.startswith(".")]
    return dict(sorted(Counter(file.suffix.lower() for file in unread if file.with_suffix("") not in read).items()))


def files_not_among(photos: Collection[Path], folder: Path) -> list[Path]:
    """Files of the folder and of those below it that are none of the photos, sorted; of hidden ones none."""
    return [file for file in _files_below(folder) if file not in photos and not file.name.startswith(".")]


def _photos_in(place: Path, suffixes: Sequence[str]) -> list[Path]:
    return sorted(file for file in place.iterdir() if file.is_file() and _is_photo(file, suffixes))


def _photos_below(place: Path, suffixes: Sequence[str], known: Collection[Path]) -> int:
    """How many photos lie in the folders of `place`, but those that are known."""
    folders = [folder for folder in place.iterdir() if folder.is_dir() and not folder.name.startswith(".")]
    return sum(photo not in known for folder in folders for photo in _photos_in(folder, suffixes))


def _files_below(place: Path) -> list[Path]:
    """The files in the folders of `place`, at any depth, sorted; of hidden folders none."""
    found: list[Path] = []
    for folder, inner, files in os.walk(place, followlinks=True):
        inner[:] = [name for name in inner if not name.startswith(".")]
        found += [Path(folder) / name for name in files]
    return sorted(found)


def named_photos(place: Path, photos: Sequence[Path]) -> dict[str, Path]:
    """The photos by their paths from `place`, sorted, with a low line for each slash: names are names of files, too.

    Raises `UserError` for photos that would be called the same, or are but for their extension, and for names that
    tables cannot hold.
    """
    named: dict[str, Path] = {}
    for photo in photos:
        name = "_".join(photo.relative_to(place).parts)
        if name in named:
            raise UserError(
                f"two photos would both be called {name}",
                where=place,
                found=" and ".join(each.relative_to(place).as_posix() for each in (named[name], photo)),
                expected="a name of its own for every photo, for views are paired by name",
                remedy="Rename one, or its folder.",
            )
        named[name] = photo
    refuse_unwritten_names(place, named)
    _refuse_equal_stems(place, named)
    return dict(sorted(named.items()))


def _is_photo(file: Path, suffixes: Sequence[str]) -> bool:
    return file.suffix.lower() in suffixes and not file.name.startswith(".")


def refuse_unwritten_names(place: Path, names: Iterable[str]) -> None:
    """Raise `UserError` for a name that tables and pages, in UTF-8, could not say, or that no file could have.

    Names from an old zip may be in an encoding that nobody states. With its folders in it a name may be too long.
    """
    for name in names:
        if not can_be_written(name[:LONGEST_NAME]):  # too long a name is told below
            raise UserError(
                "the name of a photo cannot be written",
                where=place,
                found=ascii(name),
                expected="a name in UTF-8 without control characters, for tables and pages call views by it",
                remedy="Rename it.",
            )
        size = len(name.encode(errors="replace"))
        if size > LONGEST_FILE_NAME or "\\" in name:
            raise UserError(
                "no file can have the name of a photo",
                where=place,
                found=f"{name[:60]}…, of {size} bytes" if size > LONGEST_FILE_NAME else name,
                expected=f"at most {LONGEST_FILE_NAME} bytes, with the folders it lies in, and no backslash",
                remedy="Rename it, or its folder.",
            )


def _refuse_equal_stems(place: Path, photos: dict[str, Path]) -> None:
    by_stem = defaultdict(list)
    for name in photos:
        by_stem[Path(name).stem].append(name)
    for names in by_stem.values():
        if len(names) > 1:
            raise UserError(
                "two photos differ only in their extension",
                where=place,
                found=" and ".join(names),
                expected="a name of its own for every photo, for views are paired by name",
                remedy="Rename one, or take it out.",
            )


def _what_is_there(folder: Path) -> str:
    kinds = Counter(entry.suffix.lower() or "no extension" for entry in folder.iterdir() if entry.is_file())
    subfolders = sorted(entry.name for entry in folder.iterdir() if entry.is_dir())
    parts = [f"{count} files ({kind})" for kind, count in kinds.most_common(5)]
    parts += [f"folders {', '.join(subfolders[:5])}"] if subfolders else []
    return "; ".join(parts) or "an empty folder"


def read_facts(photo: Path, posed: bool = False) -> PhotoFacts:
    """Reads a photo to its last byte, so that damage shows here; raises `UserError` as `read_picture` does.

    Of a photo that is `posed` they are those of its pixels as stored: COLMAP, and what writes transforms.json, know
    nothing of EXIF's orientation, so that their poses and lenses are of those. Other photos are upright.
    """
    height, width = read_picture(photo).shape[:2]
    with open_picture(photo) as image:
        turned = orientation_of(image) if posed else UPRIGHT
        equivalent, camera = _millimetres(image, FOCAL_LENGTH_IN_35MM), _camera(image)
    size = (height, width) if turned in SIDEWAYS else (width, height)
    focal_pixels = None if equivalent is None else equivalent / DIAGONAL_OF_35MM * math.hypot(width, height)
    return PhotoFacts(size, focal_pixels, turned, camera)


def taken_by(photos: Mapping[str, Path], facts: Mapping[str, PhotoFacts]) -> tuple[int, ...]:
    """A number for each photo, equal for those that one camera may have taken, zoomed alike: by EXIF, and where it is
    silent by the folder that the photo lies in, as of a rig's cameras."""
    told = [facts[name].camera or f"in {photo.parent}" for name, photo in photos.items()]
    numbers = {camera: number for number, camera in enumerate(dict.fromkeys(told))}
    return tuple(numbers[camera] for camera in told)


def _camera(image: Image.Image) -> str:
    """Maker and model, and the focal length in millimetres; empty where EXIF tells no model, or cannot be read."""
    try:
        maker, model = (str(image.getexif().get(tag, "")).strip(" \0") for tag in (MAKER, MODEL))
    except BROKEN_EXIF:
        return ""
    return f"{maker} {model} {_millimetres(image, FOCAL_LENGTH) or 0:.2f}" if model else ""


def _millimetres(image: Image.Image, tag: int) -> float | None:
    """A focal length of EXIF's; None where it does not say, or cannot be read: SfM finds it as well."""
    try:
        millimetres = float(image.getexif().get_ifd(EXIF_FOLDER)[tag])
    except BROKEN_EXIF:
        return None
    return millimetres if math.isfinite(millimetres) and millimetres > 0 else None


def poses_at(place: Path) -> Path:
    """A file of poses as it is, of a folder what `find_poses` finds; raises `UserError` where that is nothing."""
    found = find_poses(place) if place.is_dir() else place
    if found is None:
        raise UserError(
            "a folder without poses",
            where=place,
            found=_what_is_there(place),
            expected=f"a COLMAP model (cameras and images, .bin or .txt) or a {FILE}",
        )
    return found


def find_poses(folder: Path) -> Path | None:
    """The COLMAP model's folder or the `transforms.json` of a capture's folder; a model comes first."""
    model = find_colmap_model(folder)
    if model is None and (folder / FILE).is_file():
        return folder / FILE
    return model


def photo_finder(photos: Collection[str], place: Path) -> Callable[[str], str | None]:
    """What finds the photo that a file of poses, which is at `place`, means by a path, or None.

    It has its file name, else its stem; of photos in several folders, the folders before it, too; and accented letters
    written as one character or as two. Its time is in proportion to the path; it raises `UserError` for one that no
    photo can have.

    >>> find = photo_finder(["left_1.jpg", "right_1.jpg", "2.png"], Path("transforms.json"))
    >>> find("images/left/1.jpg"), find("right/1"), find("images/2.jpg"), find("1.jpg")
    ('left_1.jpg', 'right_1.jpg', '2.png', None)
    """
    named = {normalize("NFC", name): name for name in photos} | {name: name for name in photos}
    stems = {Path(written).stem: name for written, name in named.items()}
    most_parts = 1 + max((name.count("_") for name in photos), default=0)  # a name has a low line for each folder

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
            for name in ("_".join(parts[start:]) for start in range(len(parts))):
                found = named.get(name) or stems.get(name) or stems.get(Path(name).stem)
                if found:
                    return found
        return None

    return find


def read_poses(
    place: Path, sizes: Mapping[str, tuple[int, int]], resized: bool = False
) -> tuple[PoseSource, list[PosedPhoto]]:
    """The poses of a COLMAP model or a transforms.json, under the names of the photos in `sizes`.

    A posed photo is matched as `photo_finder` says; its lens is scaled to the photo's size, which is another than that
    of the photos that were posed where they are `resized`. Raises `UserError` for what cannot be read, for poses whose
    photo is not there, paths that are too long, twice posed photos, and other aspects.
    """
    photo_named = photo_finder(sizes, place)

    def size_of(name: str) -> tuple[int, int]:
        photo = photo_named(name)
        return sizes[photo] if photo is not None else (1, 1)

    source: PoseSource = "colmap" if place.is_dir() else "transforms"
    posed = read_colmap_model(place) if place.is_dir() else read_transforms(place, size_of, resized=resized)
    matched = {each.name: photo_named(each.name) for each in posed}
    missing = [name for name, photo in matched.items() if photo is None]
    if missing or not posed:
        raise UserError(
            "poses came for photos that do not exist" if posed else "a file of poses without poses",
            where=place,
            found=f"{len(missing)} of {len(posed)}: {', '.join(missing[:3])}" if posed else "0 photos",
            expected=f"the names of the {len(sizes)} photos, such as {min(sizes)}" if sizes else "frames",
            remedy="Put the photos there, or take the poses out of the folder to have them estimated.",
        )
    renamed = [PosedPhoto(str(matched[each.name]), each.world_to_camera, each.lens) for each in posed]
    name, times = Counter(each.name for each in renamed).most_common(1)[0]
    if times > 1:
        raise UserError(f"photo {name} is posed twice", where=place, remedy="Keep one pose for every photo.")
    fitted = [PosedPhoto(p.name, p.world_to_camera, _fitted(place, p, sizes[p.name])) for p in renamed]
    return source, sorted(fitted, key=lambda photo: photo.name)


def _fitted(place: Path, photo: PosedPhoto, size: tuple[int, int]) -> Lens:
    lens = photo.lens
    if (
        max(lens.width, lens.height) > LARGEST_SIDE
        or abs(lens.width / lens.height / (size[0] / size[1]) - 1) > ASPECT_TOLERANCE
    ):
        raise UserError(
            f"the poses are for a photo {photo.name} of another shape",
            where=place,
            found=f"{lens.width} x {lens.height} pixels",
            expected=f"{size[0]} x {size[1]} pixels, or the same proportions",
            remedy="Use the photos that the poses were made from, neither cropped nor turned.",
        )
    return lens.resized(*size)


def known_poses(source: PoseSource, posed: list[PosedPhoto]) -> KnownPoses:
    """Poses of the photos in this order."""
    return KnownPoses(
        source, np.stack([photo.world_to_camera for photo in posed]), tuple(photo.lens for photo in posed)
    )
