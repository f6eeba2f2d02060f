"""A folder of photos: which files are photos of the capture, and what they are called."""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.errors import UserError
from stages.imaging.names import LONGEST_NAME, can_be_written
from stages.scene.folder_walk import folders_from
from stages.scene.photos_below import is_photo, may_hold_photos, photos_below
from stages.scene.plurals import agreeing, counted

SUFFIXES = (".jpg", ".jpeg", ".jfif", ".png", ".webp", ".bmp", ".tif", ".tiff")
ANIMATIONS = (".gif",)
"""Not photos, except to stages that look through pictures of any kind."""
OTHER_PICTURES = (".heic", ".heif", ".avif", ".jxl", ".gif", ".dng", ".cr2", ".cr3", ".nef", ".arw")
"""Formats that phones and cameras write, but that are not read as photos."""
SUBFOLDERS = ("images", "input", "photos", "rgb")
"""Where captures keep their photos, if not in the folder itself."""

LONGEST_FILE_NAME = 255
"""Bytes, on most file systems."""


@dataclass(frozen=True)
class PhotoFolder:
    """The photos of a folder by file name, sorted, and how many other files are beside them.

    `unread` counts, by suffix, pictures that cannot be read, unless the same photo is also there in a format that can.
    `left_out`: photos in another place that was searched, such as a preview beside `images`. `below`: photos in other
    subfolders that may belong to the capture, such as those of a rig with a few stray photos beside its folders.
    """

    photos: dict[str, Path]
    ignored: int
    left_out: tuple[Path, ...] = ()
    unread: Mapping[str, int] = field(default_factory=dict)
    below: tuple[Path, ...] = ()


def find_photos(folder: Path, images: str | None = None) -> PhotoFolder:
    """The photos of `folder`, or of the first of its `SUBFOLDERS` with any, if that has more.

    If neither has any, those at any depth below one of the `SUBFOLDERS`, such as those of a rig's cameras, or a
    phone's. Names then include the folders: `left/0001.jpg` becomes `left_0001.jpg`. With `images`, only the subfolder
    of that name is searched, in the same way. Raises `UserError` if there is no folder or no photo, for names that
    tables cannot hold, and for photos that differ only in extension: results are paired by name.
    """
    _refuse_missing(folder, images)
    own = [folder / name for name in (SUBFOLDERS if images is None else (images,)) if (folder / name).is_dir()]
    found = _found_directly(folder, own, images) or _found_below(own)
    if found is None:
        searched = images or f"it or in its folder {', '.join(SUBFOLDERS)}"
        raise UserError(
            "a folder without photos",
            where=folder,
            found=what_is_there(folder),
            expected=f"photos ({', '.join(SUFFIXES)}) in {searched}",
            remedy=_how_to_have_photos([*folder.iterdir(), *(file for place in own for file in files_below(place))]),
        )
    return found


def _refuse_missing(folder: Path, images: str | None) -> None:
    if not folder.is_dir():
        raise UserError(
            "no such folder of photos",
            where=folder,
            found="a file" if folder.exists() else "nothing",
            remedy="Name the folder that holds the photos.",
        )
    if images is not None and not (folder / images).is_dir():
        raise UserError(
            f"a capture without a folder {images}",
            where=folder,
            found=what_is_there(folder),
            expected="a folder of that name (parameter images)",
        )


def _found_directly(folder: Path, own: Sequence[Path], images: str | None) -> PhotoFolder | None:
    """The photos directly in `folder` or in the first of its `own` subfolders with any; None if neither has any."""
    inside = next(((place, photos) for place in own if (photos := photos_in(place, SUFFIXES))), (folder, []))
    beside = (folder, photos_in(folder, SUFFIXES) if images is None else [])
    (place, photos), (_, left_out) = (beside, inside) if len(beside[1]) >= len(inside[1]) else (inside, beside)
    if not photos:
        return None
    files = [file for file in place.iterdir() if file.is_file()]
    below = photos_below(folder if images is None else place, photos, left_out, {*own} - {place}, SUFFIXES)
    return PhotoFolder(
        named_photos(place, photos),
        len(files) - len(photos),
        tuple(left_out),
        unread_among(files, photos),
        tuple(below),
    )


def _found_below(own: Iterable[Path]) -> PhotoFolder | None:
    """The photos at any depth below the first of the `own` subfolders that has any; None if none has."""
    for place in own:
        files = files_below(place)
        photos = _of_cameras(place, [file for file in files if is_photo(file, SUFFIXES)])
        if photos:
            return PhotoFolder(
                named_photos(place, photos), len(files) - len(photos), unread=unread_among(files, photos)
            )
    return None


def _of_cameras(place: Path, photos: list[Path]) -> list[Path]:
    """Those of the photos below `place` in no folder called like masks or previews; all if there are no others."""
    taken = [photo for photo in photos if all(map(may_hold_photos, photo.relative_to(place).parts[:-1]))]
    return taken or photos


def copies_among(photos: Mapping[str, Path]) -> list[str]:
    """The names of photos that are byte for byte the same as an earlier one."""
    same_size = Counter(photo.stat().st_size for photo in photos.values())
    seen: set[bytes] = set()
    copies = []
    for name, photo in photos.items():
        if same_size[photo.stat().st_size] > 1:
            digest = hashlib.sha256(photo.read_bytes()).digest()
            if digest in seen:
                copies.append(name)
            seen.add(digest)
    return copies


def _how_to_have_photos(found: Sequence[Path]) -> str:
    unread = unread_among(found, ())
    convert = f"Convert the pictures ({', '.join(unread)}), which cannot be read, to JPEG. " if unread else ""
    if unread and not any(entry.is_dir() for entry in found):
        return convert.strip()
    return (
        f"{convert}Those of several folders, such as the cameras of a rig, are taken if the folders lie in one called "
        f"{SUBFOLDERS[0]}; of one of them alone if the parameter images names it."
    )


def unread_among(files: Iterable[Path], photos: Iterable[Path]) -> dict[str, int]:
    """How many files are pictures that cannot be read, by suffix; not those that a camera wrote beside a photo."""
    read = {photo.with_suffix("") for photo in photos}
    unread = [file for file in files if file.suffix.lower() in OTHER_PICTURES and not file.name.startswith(".")]
    return dict(sorted(Counter(file.suffix.lower() for file in unread if file.with_suffix("") not in read).items()))


def refuse_unread(folder: Path, found: PhotoFolder) -> None:
    """Raise `UserError` if most pictures cannot be read, such as a phone's HEIC: the few others are no capture."""
    if sum(found.unread.values()) > len(found.photos):
        unread = ", ".join(f"{count} {suffix}" for suffix, count in found.unread.items())
        raise UserError(
            "most pictures of the folder cannot be read",
            where=folder,
            found=f"{unread}, beside {len(found.photos)} that can",
            expected=f"photos ({', '.join(SUFFIXES)})",
            remedy="Convert those pictures to JPEG, or take them out of the folder.",
        )


def files_not_among(photos: Collection[Path], folder: Path) -> list[Path]:
    """Files of the folder, at any depth, that are not among the photos, sorted; without hidden files."""
    return [file for file in files_below(folder) if file not in photos and not file.name.startswith(".")]


def photos_in(place: Path, suffixes: Sequence[str]) -> list[Path]:
    """The photos directly in a folder, sorted."""
    return sorted(file for file in place.iterdir() if file.is_file() and is_photo(file, suffixes))


def files_below(place: Path) -> list[Path]:
    """The files of `place` and of folders below it, at any depth, sorted; without hidden folders."""
    walked = folders_from(place, lambda name: not name.startswith("."))
    return sorted(folder / name for folder, files in walked for name in files)


def named_photos(place: Path, photos: Sequence[Path]) -> dict[str, Path]:
    """The photos by their paths from `place`, sorted, with underscores for slashes: names are file names, too.

    Raises `UserError` for names that are equal or differ only in extension, and for names that tables cannot hold.
    """
    named: dict[str, Path] = {}
    for photo in photos:
        name = "_".join(photo.relative_to(place).parts)
        if name in named:
            raise UserError(
                f"two photos would have the same name, {name}",
                where=place,
                found=" and ".join(each.relative_to(place).as_posix() for each in (named[name], photo)),
                expected="a name of its own for every photo, because views are paired by name",
                remedy="Rename one, or its folder.",
            )
        named[name] = photo
    refuse_unwritten_names(place, named)
    _refuse_equal_stems(place, named)
    return dict(sorted(named.items()))


def refuse_unwritten_names(place: Path, names: Iterable[str]) -> None:
    """Raise `UserError` for a name that tables and pages in UTF-8 cannot represent, or that no file can have.

    Names from an old zip may be in an undeclared encoding. With its folders, a name may be too long.
    """
    for name in names:
        if not can_be_written(name[:LONGEST_NAME]):  # a name that is too long is reported below
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
                expected="a name of its own for every photo, because views are paired by name",
                remedy="Rename one, or take it out.",
            )


def what_is_there(folder: Path) -> str:
    """For an error: how many files of which kinds, and the subfolders."""
    kinds = Counter(entry.suffix.lower() or "no extension" for entry in folder.iterdir() if entry.is_file())
    subfolders = sorted(entry.name for entry in folder.iterdir() if entry.is_dir())
    parts = [f"{counted(count, 'file')} ({kind})" for kind, count in kinds.most_common(5)]
    parts += [f"{agreeing(len(subfolders), 'folder[s]')} {', '.join(subfolders[:5])}"] if subfolders else []
    return "; ".join(parts) or "an empty folder"
