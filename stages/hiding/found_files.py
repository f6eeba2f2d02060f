"""Found containers: a PLY that is read like the published one, whatever has been done to it since.

Programs that save splats keep neither comments nor the order and type of columns, and thieves keep what they like. So
only the names of columns must match. Whose Gaussians they are is left to registration.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Shaped

from pipeline.errors import UserError
from pipeline.plain_text import listed
from stages.hiding.bundle import GAUSSIANS
from stages.hiding.columns import VERTEX, attribute_of, layout_of
from stages.hiding.coupled import FEATURES
from stages.hiding.method import LARGEST_SETTING
from stages.hiding.renamed_features import renamed_features, unknown_columns
from stages.scene.garbage import LARGEST, SMALLEST_QUATERNION
from stages.scene.ply.reading import ROWS_AT_ONCE, Ply, begins_as_ply, read_ply, types_of
from stages.scene.spherical_harmonics import SH_REST
from stages.scene.splat_files.compressed_ply import is_compressed
from stages.scene.splat_files.values import LARGEST_LOGIT

PLY_SUFFIX, RECORDS_SUFFIX = ".ply", ".splat"
OPACITY = "opacity"
LISTED = 5
NUMBER = "[0-9]{1,6}"

HARMONICS = layout_of(SH_REST).names.removesuffix("*")

Shapes = Mapping[str, tuple[int, ...]]


@dataclass(frozen=True)
class Found:
    """Attributes [N, ...] of the Gaussians that were found, N > 0, and the number of Gaussians that were `left_out`.

    `renamed` are the columns that were read as features, if their names differ from the published ones.
    """

    attributes: Mapping[str, Float32[np.ndarray, "N ..."]]
    left_out: int
    renamed: tuple[str, ...] = ()


def read_found(place: Path, published: Shapes) -> Found:
    """Read a PLY, or the one in a folder, by column names, in any order and of any type; other columns are ignored.

    `published` holds the shapes of one Gaussian's attributes. There may be any number of feature columns up to 1024. If
    there are none, as many columns under another common name are read instead; whether these are features is left to
    the caller. Gaussians that no scene has (NaN, infinity, absurd values) are left out: a single one, which no viewer
    shows, would otherwise keep the owner from recovering the container. Raises `UserError` if there is no PLY or more
    than one, for a broken file, for the formats that keep no features (PlayCanvas's compressed PLY, `.splat`), for
    missing columns, and if no Gaussian is left. Time and memory are proportional to the file size.
    """
    ply = _read(_ply_at(place))
    rows = ply.rows(VERTEX)
    channels = _channels(rows.dtype.names or ())
    unknown = unknown_columns(types_of(rows.dtype), _columns(published))
    renamed = [] if channels else renamed_features(unknown, math.prod(published.get(FEATURES, (0,))))
    channels = channels or renamed
    shapes = dict(published) | ({FEATURES: (max(len(channels), 1),)} if FEATURES in published else {})
    numbered = dict(zip(layout_of(FEATURES).columns(len(channels)), channels, strict=True))
    numbered |= _renumbered_harmonics(rows.dtype.names or (), published)
    sources = {column: numbered.get(column, column) for column in _columns(shapes)}
    _check_columns(ply, list(sources.values()), unknown)
    table = _finite(rows, sources)
    finite = Ply(ply.path, ply.comments, {VERTEX: table})
    attributes = {name: attribute_of(finite, name, shape) for name, shape in shapes.items()}
    sound = _sound(attributes)
    if not sound.any():
        raise UserError(
            "a file without Gaussians that a scene may have",
            where=ply.path,
            found=f"{len(rows)}, of which none has finite values of magnitudes that a scene has" if len(rows) else "0",
            expected="at least one",
        )
    kept = attributes if sound.all() else {name: values[sound] for name, values in attributes.items()}
    return Found(kept, len(rows) - int(sound.sum()), tuple(renamed))


def _read(path: Path) -> Ply:
    """The PLY, unless the file is in a format of splats that only viewers need."""
    if path.suffix.lower() == RECORDS_SUFFIX and path.is_file() and not begins_as_ply(path):
        raise _without_features(path, f"a {RECORDS_SUFFIX}")
    ply = read_ply(path)
    if is_compressed(ply.elements):
        raise _without_features(path, "a compressed PLY")
    return ply


def _without_features(path: Path, found: str) -> UserError:
    return UserError(
        "a file in a format without features",
        where=path,
        found=found,
        expected="a PLY with the columns of the published container",
        remedy="This format keeps only what viewers of 3DGS show: features, and the message in them, are gone from the "
        "file. Look for an uncompressed PLY of the same splats.",
    )


def _ply_at(place: Path) -> Path:
    if not place.is_dir():
        return place
    if (place / GAUSSIANS).is_file():
        return place / GAUSSIANS
    there = sorted(path.name for path in place.iterdir())
    files = [name for name in there if name.lower().endswith(PLY_SUFFIX)]
    if len(files) != 1:
        shown = files or there
        raise UserError(
            "no container" if not files else "several files that may be the container",
            where=place,
            found=listed(shown, LISTED) if shown else "an empty folder",
            expected=f"{GAUSSIANS}, or one other file {PLY_SUFFIX}",
            remedy="give the file itself" if files else "give the folder or the PLY that was found",
        )
    return place / files[0]


def _columns(shapes: Shapes) -> list[str]:
    return [column for name, shape in shapes.items() for column in layout_of(name).columns(math.prod(shape))]


def _channels(names: Sequence[str]) -> list[str]:
    """The feature columns in the order of their numbers, at most 1024; numbers may be missing, or have leading zeros.

    Of two columns with the same number, the one without zeros is taken, as it is the published name.
    """
    prefix = layout_of(FEATURES).names.removesuffix("*")
    numbered: dict[int, str] = {}
    for name in sorted(names, key=len, reverse=True):
        if re.fullmatch(f"{prefix}{NUMBER}", name):
            numbered[int(name.removeprefix(prefix))] = name
    return [numbered[number] for number in sorted(numbered)[:LARGEST_SETTING]]


def _renumbered_harmonics(names: Sequence[str], published: Shapes) -> dict[str, str]:
    """The columns of the published harmonics in a file that has more of them; empty if it has as many or fewer.

    All of red are stored before green, so their numbers depend on the degree, which programs raise to 3.
    """
    columns = layout_of(SH_REST).columns(sum(re.fullmatch(rf"{HARMONICS}\d+", name) is not None for name in names))
    wanted, there = published.get(SH_REST, (0, 3))[0], len(columns) // 3
    if there <= wanted or not set(columns) <= set(names):
        return {}
    own = layout_of(SH_REST).columns(3 * wanted)
    return {own[color * wanted + row]: columns[color * there + row] for color in range(3) for row in range(wanted)}


def _check_columns(ply: Ply, columns: Sequence[str], unknown: Sequence[str]) -> None:
    names = ply.rows(VERTEX).dtype.names or ()
    missing = [name for name in columns if name not in names]
    if missing:
        raise UserError(
            "not a container like the published one",
            where=ply.path,
            found=f"no columns {listed(missing)} among {listed(names) or 'none'}",
            expected="those of the published container, in any order",
            remedy=_how_to_have_columns(missing, unknown),
        )


def _how_to_have_columns(missing: Sequence[str], unknown: Sequence[str]) -> str:
    if all(name.startswith(HARMONICS) for name in missing):
        return "The program that saved it dropped harmonics, the colours that depend on the view: find a whole file."
    if not unknown:
        return (
            "Check that it is the file that was found. Splats without what a container's Gaussians carry hide no "
            "message, from whatever they were made."
        )
    first = layout_of(FEATURES).columns(1)
    if [*missing] == first:
        return f"These may be its features: {listed(unknown)}. Rename them to {first[0]}, ... in their order."
    return f"These may be the missing ones: {listed(unknown)}. Rename them as they were, in their order."


def _finite(rows: Shaped[np.ndarray, " N"], sources: Mapping[str, str]) -> Shaped[np.ndarray, " K"]:
    """The columns of `sources` as float32 under their new names, for the rows that are finite in all of them.

    Opacities are logits; programs that store bytes write infinite ones for 0 and 1, which are replaced by large ones.
    """
    table = np.empty(len(rows), [(name, "<f4") for name in sources])
    finite = np.ones(len(rows), bool)
    for start in range(0, len(rows), ROWS_AT_ONCE):
        block = slice(start, start + ROWS_AT_ONCE)
        for name, source in sources.items():
            with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite
                values = rows[source][block].astype(np.float32)
            if name == OPACITY:
                values = np.where(np.isinf(values), np.copysign(np.float32(LARGEST_LOGIT), values), values)
            table[name][block] = values
            finite[block] &= np.isfinite(values)
    return table if finite.all() else table[finite]


def _sound(attributes: Mapping[str, Float32[np.ndarray, "N ..."]]) -> Bool[np.ndarray, " N"]:
    """Which Gaussians have magnitudes that occur in scenes, and a quaternion that is long enough to give a rotation."""
    lengths = np.linalg.norm(attributes["quats"].astype(np.float64), axis=1)
    sound = np.asarray(lengths >= SMALLEST_QUATERNION)
    for name, values in attributes.items():
        limit = next((limit for ending, limit in LARGEST.items() if name.endswith(ending)), np.inf)
        if name != "quats":
            sound &= (np.abs(values) <= limit).all(axis=tuple(range(1, values.ndim)))
    return sound
