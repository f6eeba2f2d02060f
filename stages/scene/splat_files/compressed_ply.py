"""PlayCanvas's compressed PLY: 16 bytes per Gaussian, quantised between the minimum and maximum of its chunk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8, UInt32

from pipeline.errors import UserError
from stages.scene.ply.rows import Elements
from stages.scene.splat_files.gaussian_ply import by_harmonic, columns, names_of_rest
from stages.scene.splat_files.values import SplatValues, base_of_colors, logits_of_bytes

CHUNK = 256
"""Gaussians that share their ranges."""
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
HARMONICS_RANGE = 4.0
"""Bytes of harmonics represent -4 to 4."""


def is_compressed(elements: Elements) -> bool:
    """Whether a PLY is in this format, intact or not."""
    return "chunk" in elements and PACKED[0] in (elements.get("vertex", np.empty(0, [])).dtype.names or ())


def values_of_compressed_ply(path: Path, elements: Elements) -> SplatValues:
    """Unpack positions, log scales and colours (11, 10 and 11 bits, or 8 each), rotations and harmonics.

    The format's first version has no colour ranges: its colours are in [0, 1]. Raises `UserError` if properties are
    missing or of another type, and if the number of chunks or harmonics does not match the Gaussians.
    """
    chunks, vertices = elements["chunk"], elements["vertex"]
    ranges = [f"{end}_{axis}" for end in ("min", "max") for axis in (*"xyz", *(f"scale_{axis}" for axis in "xyz"))]
    colored = "min_r" in (chunks.dtype.names or ())
    if colored:
        ranges += [f"{end}_{channel}" for end in ("min", "max") for channel in "rgb"]
    _require(path, "chunk", chunks, ranges, "f")
    _require(path, "vertex", vertices, PACKED, "u4")
    if len(chunks) != -(-len(vertices) // CHUNK):
        raise UserError(
            "a compressed PLY with a wrong number of chunks",
            where=path,
            found=f"{len(chunks)} for {len(vertices)} Gaussians",
            expected=f"one for each {CHUNK}",
        )

    def within(shares: Float[np.ndarray, "N 3"], names: list[str]) -> Float[np.ndarray, "N 3"]:
        ends = (columns(chunks, [f"{end}_{name}" for name in names]).astype(np.float64) for end in ("min", "max"))
        least, largest = (end.repeat(CHUNK, axis=0)[: len(shares)] for end in ends)
        with np.errstate(invalid="ignore", over="ignore"):  # ranges that are not finite are refused later
            return least + shares * (largest - least)

    packed = {name: vertices[name].astype(np.uint32) for name in PACKED}
    colors = units(packed["packed_color"], (8, 8, 8, 8))
    return SplatValues(
        means=within(units(packed["packed_position"], (11, 10, 11)), list("xyz")),
        quats=rotations(packed["packed_rotation"]),
        log_scales=within(units(packed["packed_scale"], (11, 10, 11)), [f"scale_{axis}" for axis in "xyz"]),
        logit_opacities=logits_of_bytes((packed["packed_color"] & np.uint32(255)).astype(np.uint8)),
        sh_base=base_of_colors(within(colors[:, :3], list("rgb")) if colored else colors[:, :3]),
        sh_rest=_harmonics(path, elements, len(vertices)),
    )


def units(packed: UInt32[np.ndarray, " N"], bits: tuple[int, ...]) -> Float[np.ndarray, "N fields"]:
    """Bit fields of an integer, the highest first, each scaled to [0, 1]."""
    fields, shift = [], sum(bits)
    for width in bits:
        shift -= width
        largest = 2**width - 1
        fields.append(((packed >> np.uint32(shift)) & np.uint32(largest)) / largest)
    return np.stack(fields, axis=1)


def rotations(packed: UInt32[np.ndarray, " N"]) -> Float[np.ndarray, "N 4"]:
    """Quaternions w x y z: two bits give the index of the largest component, which follows from the other three."""
    others = (units(packed & np.uint32(2**30 - 1), (10, 10, 10)) - 0.5) * np.sqrt(2)
    largest = np.sqrt((1 - np.square(others).sum(axis=1)).clip(0))
    is_largest = np.arange(4) == (packed >> np.uint32(30))[:, None]
    quats = np.empty((len(packed), 4))
    quats[is_largest] = largest
    quats[~is_largest] = others.reshape(-1)
    return quats


def _harmonics(path: Path, elements: Elements, count: int) -> Float[np.ndarray, "N rest 3"]:
    rows = elements.get("sh")
    if rows is None:
        return np.empty((count, 0, 3))
    names = names_of_rest(path, rows.dtype.names or ())
    _require(path, "sh", rows, names, "u1")
    if len(rows) != count:
        raise UserError(
            "a compressed PLY with a wrong number of spherical harmonics",
            where=path,
            found=f"{len(rows)} rows for {count} Gaussians",
            expected="one for each",
        )
    return by_harmonic(harmonics_of_bytes(np.stack([rows[name] for name in names], axis=1)))


def harmonics_of_bytes(stored: UInt8[np.ndarray, "N C"]) -> Float[np.ndarray, "N C"]:
    """The middle of each of 256 equal steps of the range; bytes 0 and 255 are exactly its ends."""
    shares = (stored + 0.5) / 256
    shares = np.where(stored == 0, 0.0, np.where(stored == 255, 1.0, shares))
    return HARMONICS_RANGE * (2 * shares - 1)


def _require(path: Path, element: str, rows: np.ndarray, names: list[str] | tuple[str, ...], kind: str) -> None:
    """Raise `UserError` unless the element has these properties, of this type."""
    for name in names:
        found = rows.dtype[name] if name in (rows.dtype.names or ()) else None
        if found is None or not found.str[1:].startswith(kind):
            raise UserError(
                f"a compressed PLY whose {element} lacks the property {name}",
                where=path,
                found="none" if found is None else f"one of type {found.name}",
                expected={"f": "a floating-point number", "u4": "an unsigned integer of 32 bits", "u1": "a byte"}[kind],
            )
