"""Photos that PyPI packages ship, for trainings that need pictures of many things: copied once, then read from there.

    pip install --no-deps --target FOLDER scikit-image==0.26.0 scikit-learn==1.9.1
    python -m stages.imaging.shipped_photos FOLDER

The packages are not installed, only these files of theirs are kept, in the user's data folder (`$GS_HIDER_DATA`, by
default the platform's own). They are recognised by their SHA-256 whenever they are read, so that a name stands for one
picture and no other.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator

from pipeline.data_folder import data_folder
from pipeline.errors import UserError
from stages.imaging.pictures import Picture, read_picture

HOW_TO_INSTALL = (
    "Install them with `pip install --no-deps --target FOLDER scikit-image==0.26.0 scikit-learn==1.9.1` and "
    "`python -m stages.imaging.shipped_photos FOLDER`."
)

DIGESTS: Mapping[str, str] = {
    "astronaut.png": "88431cd9653ccd539741b555fb0a46b61558b301d4110412b5bc28b5e3ea6cb5",
    "chelsea.png": "596aa1e7cb875eb79f437e310381d26b338a81c2da23439704a73c4651e8c4bb",
    "china.jpg": "8378025ad2519d649d02e32bd98990db4ab572357d9f09841c2fbfbb4fefad29",
    "coffee.png": "cc02f8ca188b167c775a7101b5d767d1e71792cf762c33d6fa15a4599b5a8de7",
    "flower.jpg": "a77f6ec41e353afdf8bdff2ea981b2955535d8d83294f8cfa49cf4e423dd5638",
    "motorcycle_left.png": "db18e9c4157617403c3537a6ba355dfeafe9a7eabb6b9b94cb33f6525dd49179",
    "rocket.jpg": "c2dd0de7c538df8d111e479619b129464d0269d0ae5fd18ca91d33a7fdfea95c",
}
"""SHA-256 of each file. All that are colour photos of one picture each: the rest of what these packages ship is grey,
drawn, or seen through a microscope."""

HELD_OUT = ("china.jpg", "chelsea.png")
"""Those that nothing is trained on: they alone show things that no photo of a training shows."""

LEARNT_FROM = tuple(name for name in DIGESTS if name not in HELD_OUT)


def photo_file(name: str) -> Path:
    """Where a photo lies, installed or not."""
    return data_folder() / f"photo-{name}"


def installed_photos() -> tuple[str, ...]:
    """The names of those that are at hand, in order."""
    return tuple(name for name in DIGESTS if photo_file(name).is_file())


def _installed_ones(wanted: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name in wanted if name in installed_photos())


ShippedPhotos = Annotated[tuple[str, ...], AfterValidator(_installed_ones)]
"""A parameter: names of shipped photos, those of which are kept that are installed."""


def read_photo(name: str) -> Picture:
    """The photo of this name. Raises `UserError` where it is not installed, or is another picture."""
    path = photo_file(name)
    try:
        found = _sha256(path.read_bytes())
    except OSError as error:
        raise UserError("a shipped photo cannot be read", where=path, found=error, remedy=HOW_TO_INSTALL) from error
    if found != DIGESTS[name]:
        raise UserError("not the photo of this name", where=path, expected=DIGESTS[name], remedy=HOW_TO_INSTALL)
    return read_picture(path)


def install_photos(folder: Path) -> list[Path]:
    """Copies the photos out of unpacked packages into the data folder; the paths that they have there.

    Raises `UserError` where one is missing or is not what it should be; what is there already stays.
    """
    return [_install(folder, name, digest) for name, digest in DIGESTS.items()]


def _install(folder: Path, name: str, digest: str) -> Path:
    content = next((data for data in map(Path.read_bytes, sorted(folder.rglob(name))) if _sha256(data) == digest), None)
    if content is None:
        raise UserError(f"no {name} of these packages in this folder", where=folder, remedy=HOW_TO_INSTALL)
    path = photo_file(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_bytes(content)
    part.replace(path)
    return path


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m stages.imaging.shipped_photos", description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="where the two packages were installed or unpacked")
    try:
        for path in install_photos(parser.parse_args(arguments).folder):
            print(path)
    except UserError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
