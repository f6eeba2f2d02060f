"""Reading the cameras and images of a COLMAP model, binary or text; `colmap_points` reads its points."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from pipeline.errors import UserError
from pipeline.plain_text import in_a_line
from stages.scene.lens import MODELS, Lens

FOLDERS = ("sparse/*", "sparse", "colmap/sparse/*", "colmap/sparse", ".")
"""Where to look for a COLMAP model, relative to a capture's folder; a star stands for the numbers of several models."""
PARTS = ("cameras", "images")
NUMBERS_OF_AN_IMAGE = 10  # in a line of text: id, quaternion, translation, camera, and name, which may contain blanks
LARGEST_TRANSLATION = 1e9
"""World units; also the limit for means of Gaussians. Products of much larger values overflow."""
ROUNDING = 1e-9


@dataclass(frozen=True)
class PosedPhoto:
    """A photo named by a model: its pose (world to camera, looking along +z) and its lens.

    `number` is the image id by which a COLMAP model's points refer to it; None from other files of poses.
    """

    name: str
    world_to_camera: Float64[np.ndarray, "4 4"]
    lens: Lens
    number: int | None = None


def find_colmap_model(folder: Path) -> Path | None:
    """The first place in `FOLDERS` with a complete model (cameras and images, both .bin or both .txt), or None.

    Of several models, the one with the most photos: COLMAP numbers them as it finds them, and model 0 may hold three
    photos out of hundreds.
    """
    for name in FOLDERS:
        models = [place for place in _numbered(folder, name) if suffix_of_model(place) is not None]
        if models:
            return models[0] if len(models) == 1 else max(models, key=photos_in_model)
    return None


def _numbered(folder: Path, name: str) -> list[Path]:
    """The folder of this name; if it ends in a star, all numbered folders there, in numerical order."""
    if not name.endswith("*"):
        return [folder / name]
    found = [place for place in folder.glob(name) if place.name.isdecimal()]
    return sorted(found, key=lambda place: (int(place.name), place.name))


def models_beside(place: Path) -> list[Path]:
    """The other models of a reconstruction that fell apart: numbered folders beside `place`, if it is one itself."""
    if not (place.is_dir() and place.name.isdecimal()):
        return []
    return [other for other in _numbered(place.parent, "*") if other != place and suffix_of_model(other) is not None]


def photos_in_model(place: Path) -> int:
    """How many photos a model poses; 0 if it is incomplete or unreadable, as other models may be sound."""
    suffix = suffix_of_model(place)
    try:
        return 0 if suffix is None else len(_READERS[suffix][1](place / f"images{suffix}"))
    except (struct.error, ValueError, OSError):
        return 0


def suffix_of_model(place: Path) -> str | None:
    """The suffix of a model's files, .bin or .txt; None if the model is incomplete."""
    whole = (suffix for suffix in _READERS if all((place / f"{part}{suffix}").is_file() for part in PARTS))
    return next(whole, None)


def read_colmap_model(folder: Path) -> list[PosedPhoto]:
    """The posed photos of the model directly in this folder, sorted by name.

    Raises `UserError` if there is none, or if its files are damaged or unsupported.
    """
    suffix = suffix_of_model(folder)
    if suffix is None:
        raise UserError(
            "a folder without a COLMAP model", where=folder, expected="cameras.bin and images.bin, or both as .txt"
        )
    read_lenses, read_images = _READERS[suffix]
    path = folder / f"cameras{suffix}"
    try:
        lenses = read_lenses(path)
        path = folder / f"images{suffix}"
        photos = [
            PosedPhoto(name, _pose(name, numbers), _lens_of(lenses, camera, name), number)
            for number, name, numbers, camera in read_images(path)
        ]
    except (struct.error, ValueError, OSError) as error:
        raise UserError(
            "a COLMAP model cannot be read",
            where=path,
            found=f"{type(error).__name__}: {error}",
            expected="the cameras and images of a COLMAP model",
            remedy="Export the model again, or take it out of the folder to have the poses estimated.",
        ) from error
    return sorted(photos, key=lambda photo: photo.name)


def _lens_of(lenses: dict[int, Lens], camera: int, name: str) -> Lens:
    if camera not in lenses:
        raise ValueError(f"{name} was taken by camera {camera}, of which the model says nothing")
    return lenses[camera]


def _pose(name: str, numbers: tuple[float, ...]) -> Float64[np.ndarray, "4 4"]:
    quaternion, translation = np.array(numbers[:4]), np.array(numbers[4:])
    largest = np.abs(quaternion).max()
    if not np.isfinite(numbers).all() or not largest:
        raise ValueError(f"the pose of {name} is not finite or no rotation: {numbers}")
    refuse_far(f"the pose of {name}", translation)
    exponent = np.frexp(largest)[1]
    w, x, y, z = np.ldexp(quaternion, -exponent)  # the square of 1e200 overflows; scaling by a power of two is exact
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    pose[:3, 3] = translation
    if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > ROUNDING:
        raise ValueError(f"the pose of {name} is no rotation: {numbers[:4]}")
    return pose


def refuse_far(what: str, translation: Float64[np.ndarray, " 3"]) -> None:
    """Raise `ValueError` for a translation beyond `LARGEST_TRANSLATION`; the message calls the pose `what`."""
    if np.abs(translation).max() > LARGEST_TRANSLATION:
        found = ", ".join(f"{value:g}" for value in translation)
        raise ValueError(f"{what} has a translation beyond {LARGEST_TRANSLATION:g}: {found}")


class _Reader:
    """Reads little-endian values from a file's bytes; raises `struct.error` or `ValueError` past the end."""

    def __init__(self, path: Path) -> None:
        self._bytes = path.read_bytes()
        self._at = 0

    def take(self, layout: str) -> tuple[float, ...]:
        values = struct.unpack_from(f"<{layout}", self._bytes, self._at)
        self._at += struct.calcsize(f"<{layout}")
        return values

    def integer(self, layout: str) -> int:
        return int(self.take(layout)[0])

    def text(self) -> str:
        end = self._bytes.index(b"\0", self._at)
        text = self._bytes[self._at : end].decode()
        self._at = end + 1
        return text

    def skip(self, count: int) -> None:
        self._at += count
        if self._at > len(self._bytes):
            raise ValueError("the file ends too early")


def _binary_lenses(path: Path) -> dict[int, Lens]:
    reader, lenses = _Reader(path), dict[int, Lens]()
    for _ in range(reader.integer("Q")):
        camera, number, width, height = (int(value) for value in reader.take("iiQQ"))
        model = tuple(MODELS)[number] if 0 <= number < len(MODELS) else str(number)
        count = sum(MODELS[model]) + 2 if model in MODELS else 0
        _enter(lenses, camera, Lens(model, reader.take(f"{count}d"), width, height))
    return lenses


def _binary_images(path: Path) -> list[tuple[int, str, tuple[float, ...], int]]:
    reader, images = _Reader(path), []
    for _ in range(reader.integer("Q")):
        number = reader.integer("I")
        numbers, camera, name = reader.take("7d"), reader.integer("I"), reader.text()
        reader.skip(24 * reader.integer("Q"))  # observations: two float64 and one int64 each
        images.append((number, name, numbers, camera))
    return images


def _text_lenses(path: Path) -> dict[int, Lens]:
    lenses: dict[int, Lens] = {}
    for number, line in _lines(path):
        if _says_something(line):
            with _naming_line(number):
                camera, model, width, height, *parameters = line.split()
                _enter(lenses, int(camera), Lens(model, tuple(map(float, parameters)), int(width), int(height)))
    return lenses


def _enter(lenses: dict[int, Lens], camera: int, lens: Lens) -> None:
    if camera in lenses:
        raise ValueError(f"camera {camera} is listed twice, so its photos are ambiguous")
    lenses[camera] = lens


def _text_images(path: Path) -> list[tuple[int, str, tuple[float, ...], int]]:
    """Images of images.txt. As in COLMAP, the line after an image's own lists its observations, and may be empty."""
    images, lines = [], _lines(path)
    for number, line in lines:
        if not _says_something(line):
            continue
        with _naming_line(number):
            parts = line.split(maxsplit=NUMBERS_OF_AN_IMAGE - 1)
            if len(parts) < NUMBERS_OF_AN_IMAGE:
                raise ValueError(f"{len(parts)} of the {NUMBERS_OF_AN_IMAGE} parts of an image")
            images.append((_number(parts[0]), parts[-1], tuple(map(float, parts[1:8])), int(parts[8])))
        number, observations = next(lines, (number, ""))
        with _naming_line(number):
            _check_observations(observations)
    return images


def _number(written: str) -> int:
    """An image id, which must fit into the 32 bits of a binary model; raises `ValueError` otherwise."""
    number = int(written)
    if not 0 <= number < 2**32:
        raise ValueError(f"a photo of number {in_a_line(written)}")
    return number


def _check_observations(line: str) -> None:
    """Raise `ValueError` unless a line lists observations (x, y and a point id each), rather than an image."""
    parts = line.split()
    if len(parts) % 3 or (parts and not parts[-1].removeprefix("-").isdecimal()):
        raise ValueError("the line of observations after an image is missing (it may be empty)")


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    return ((number, line.strip()) for number, line in enumerate(path.read_text("utf-8-sig").split("\n"), start=1))


def _says_something(line: str) -> bool:
    return bool(line) and not line.startswith("#")


@contextmanager
def _naming_line(number: int) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise ValueError(f"line {number}: {error}") from error


_READERS = {".bin": (_binary_lenses, _binary_images), ".txt": (_text_lenses, _text_images)}
