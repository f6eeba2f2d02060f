"""Photos in subfolders that were not asked for, but may belong to the capture."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path

from stages.scene.folder_walk import folders_from

OTHER_SIZES = re.compile(r"images_\d+")
"""Downscaled copies, beside the photos of Mip-NeRF 360 and those that nerfstudio processed."""
NO_PHOTOS = frozenset(
    [
        *("mask", "masks", "depth", "depths", "disparity", "normals", "segmentation", "segmentations", "semantic"),
        *("semantics", "confidence", "thumb", "thumbs", "thumbnail", "thumbnails", "preview", "previews", "eadir"),
        *("cache", "render", "renders", "rendered", "sparse", "stereo", "distorted", "undistorted"),
    ]
)
"""Words in names of folders whose pictures a program, such as COLMAP, a phone or a network, derived from photos."""


def photos_below(
    top: Path, taken: Collection[Path], left_out: Collection[Path], own: Collection[Path], suffixes: Sequence[str]
) -> list[Path]:
    """Photos below `top`, at any depth, that may belong to the capture and were neither taken nor left out, sorted.

    Skipped are hidden folders, folders whose names say that they hold no photos, and folders with exactly the names of
    the photos taken: copies, masks or depths of these. In the folders `own`, where captures keep their photos, one such
    name is enough: they may hold the originals of photos of which some were undistorted.
    """
    known, names = {*taken, *left_out}, {_stem(photo) for photo in taken}
    below: list[Path] = []
    for folder, files in folders_from(top, may_hold_photos):
        photos = [folder / name for name in files if is_photo(folder / name, suffixes)]
        stems = {_stem(photo) for photo in photos}
        if folder != top and stems != names and not (folder in own and stems & names):
            below += [photo for photo in photos if photo not in known]
    return sorted(below)


def is_photo(file: Path, suffixes: Sequence[str]) -> bool:
    """Whether a file is named like a photo and not hidden; systems leave hidden files of such names behind."""
    return file.suffix.lower() in suffixes and not file.name.startswith(".")


def may_hold_photos(name: str) -> bool:
    """Whether a folder of this name may hold photos: it is not hidden, and not called like what is made of photos."""
    words = re.findall(r"[a-z]+", name.lower())
    return not (name.startswith(".") or OTHER_SIZES.fullmatch(name.lower()) or NO_PHOTOS.intersection(words))


def _stem(photo: Path) -> str:
    return photo.stem.casefold()
