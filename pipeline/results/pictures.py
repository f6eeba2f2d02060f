"""The pictures in an artifact, as files: parts of arrays that have the shape of a picture, and plain picture files.

The shape of an array of pictures ends in [height, width] or [height, width, 3 or 4], with sides of at least `SMALLEST`
pixels, neither more than `LONGEST` times the other, which rules out tables and weights. Values are uint8, bool, or
floating point in [0, 1]; beyond that, colours are clipped, and grey values scaled.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, TypeVar

from pipeline.artifact import Artifact
from pipeline.errors import CommandError
from pipeline.manifest import ArrayRecord
from pipeline.results.description import range_of
from pipeline.results.privacy import make_folder, new_file

if TYPE_CHECKING:
    import numpy as np
    from PIL import Image

SMALLEST = 16
LONGEST = 8
FILES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")

Item = TypeVar("Item")


@dataclass(frozen=True)
class Picture:
    """One picture: a plain file if `index` is None, otherwise the part of an array at `index` along its first axes."""

    source: str
    index: tuple[int, ...] | None

    def file_name(self, digits: int) -> str:
        """The name to write it to: `1/truth` at 7 becomes `1-truth-0007.png`; files keep theirs, with `-` for `/`."""
        if self.index is None:
            return self.source.replace("/", "-")
        name = re.sub(r"[^A-Za-z0-9_.-]+", "-", self.source)
        return f"{'-'.join([name, *(f'{number:0{digits}}' for number in self.index)])}.png"


def pictures_of(artifact: Artifact) -> list[Picture]:
    """All pictures in an artifact: those in arrays, then files, each in order."""
    found = []
    for name in artifact.names:
        axes = leading_axes(artifact.manifest.arrays[name])
        if axes is not None:
            found += [Picture(name, index) for index in itertools.product(*map(range, axes))]
    files = [name for name in artifact.files if PurePosixPath(name).suffix.lower() in FILES]
    return found + [Picture(name, None) for name in files]


def leading_axes(array: ArrayRecord) -> tuple[int, ...] | None:
    """The shape of the axes before those of a picture; None if the array holds no pictures.

    >>> [leading_axes(ArrayRecord("|u1", shape, shape, "")) for shape in ((48, 72, 96, 3), (72, 96), (9000, 16, 3))]
    [(48,), (), None]
    """
    shape = array.shape
    colours = len(shape) >= 3 and shape[-1] in (3, 4)
    sides = shape[-3:-1] if colours else shape[-2:]
    if array.dtype[1:] not in ("u1", "b1", "f2", "f4", "f8") or len(sides) < 2 or min(sides) < SMALLEST:
        return None
    if max(sides) > LONGEST * min(sides) or 0 in shape:
        return None
    return shape[: len(shape) - (3 if colours else 2)]


def write_pictures(artifact: Artifact, folder: Path, most: int | None) -> tuple[list[Path], int]:
    """Writes at most `most` pictures, selected by `drawn`, into `folder`; if `most` is None, all of them.

    Returns their paths, and the number of pictures in the artifact. Files of a private artifact are closed to others,
    and so is the folder if it is created here. Raises CommandError, and writes nothing, if one of the files exists.
    """
    found = pictures_of(artifact)
    chosen = found if most is None else drawn(found, most)
    digits = max((len(str(max(picture.index))) for picture in found if picture.index), default=1)
    paths = [folder / picture.file_name(digits) for picture in chosen]
    _check_free(paths)
    if chosen:
        make_folder(folder.absolute(), artifact.private)
    scales: dict[str, tuple[float, float]] = {}
    for picture, path in zip(chosen, paths, strict=True):
        with new_file(path, artifact.private) as file:
            if picture.index is None:
                with artifact.file(picture.source).open("rb") as source:
                    shutil.copyfileobj(source, file)
            else:
                if picture.source not in scales:
                    scales[picture.source] = _scale(artifact, picture.source)
                _to_image(artifact.item(picture.source, picture.index), *scales[picture.source]).save(
                    file, format="PNG"
                )
    return paths, len(found)


def _check_free(paths: Sequence[Path]) -> None:
    """Raises CommandError if one of the files exists: pictures of another artifact may have the same names."""
    taken = next(filter(os.path.lexists, paths), None)
    if taken:
        raise CommandError(
            "a picture with this name already exists",
            where=taken,
            expected="a folder without pictures of these names, or a new one",
            remedy="Choose another folder, or remove the pictures first.",
        )


def drawn(pictures: Sequence[Picture], most: int) -> list[Picture]:
    """At most `most` of the pictures, spread evenly over all.

    As far as `most` allows, the same indices are taken from each array, so that every rendering comes with its truth.
    """
    places: dict[object, list[Picture]] = {}
    for picture in pictures:
        places.setdefault(picture.source if picture.index is None else picture.index, []).append(picture)
    number = most // max(map(len, places.values()), default=1)
    if number:
        return [picture for place in _evenly(list(places.values()), min(number, len(places))) for picture in place]
    return _evenly(pictures, min(most, len(pictures)))


def _evenly(items: Sequence[Item], number: int) -> list[Item]:
    return [items[position * len(items) // number] for position in range(number)]


def _scale(artifact: Artifact, name: str) -> tuple[float, float]:
    """The values that become black and white."""
    record = artifact.manifest.arrays[name]
    grey = len(record.shape) - len(leading_axes(record) or ()) == 2
    values = range_of(artifact, name) if grey and record.dtype[1] == "f" else None
    if values is None or values.least is None or values.greatest is None:
        return 0.0, 1.0
    inside = values.least >= 0 and values.greatest <= 1
    return (0.0, 1.0) if inside else (values.least, values.greatest)


def _to_image(pixels: np.ndarray, black: float, white: float) -> Image.Image:
    import numpy as np
    from PIL import Image

    if pixels.dtype.kind == "b":
        pixels = pixels.astype(np.uint8) * 255
    if pixels.dtype.kind == "f":
        shares = (pixels.astype(np.float64) - black) / ((white - black) or 1.0)
        pixels = np.rint(np.nan_to_num(np.clip(shares, 0.0, 1.0)) * 255).astype(np.uint8)
    return Image.fromarray(np.ascontiguousarray(pixels))
