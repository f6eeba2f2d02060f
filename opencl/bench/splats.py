"""Reads trained Gaussians from `.splat` files and from PlayCanvas's compressed PLY files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt32
from torch import Tensor

from opencl.bench.ply import read_elements

_SPLAT = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("quat", "u1", 4)])
_CHUNK = 256
"""Gaussians per chunk of a compressed PLY, which share their quantisation ranges."""
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")


@dataclass(frozen=True)
class Splats:
    """Gaussians with activated values: scales in world units, opacities and colours in [0, 1], quaternions w x y z."""

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    scales: Float[Tensor, "N 3"]
    opacities: Float[Tensor, " N"]
    colors: Float[Tensor, "N 3"]


def read_splats(path: Path) -> Splats:
    """Read the Gaussians of a `.splat` or compressed `.ply` file, as float32.

    Raises ValueError if the suffix or the contents do not fit these formats, and OSError if the file cannot be read.
    """
    if path.suffix == ".splat":
        return _read_splat(path)
    if path.suffix == ".ply":
        return _read_compressed_ply(path)
    raise ValueError(f"{path}: found the suffix {path.suffix!r}, expected .splat or .ply (PlayCanvas's compressed PLY)")


def _read_splat(path: Path) -> Splats:
    """Read a `.splat` file: records of 32 bytes, without a header."""
    content = path.read_bytes()
    if len(content) % _SPLAT.itemsize:
        raise ValueError(
            f"{path}: found {len(content)} bytes, expected a multiple of {_SPLAT.itemsize}, one record a Gaussian; "
            "the file is truncated or of another format"
        )
    records = np.frombuffer(content, _SPLAT)
    colors = records["color"].astype(np.float32) / 255
    return _splats(
        records["mean"], (records["quat"].astype(np.float32) - 128) / 128, records["scale"], colors[:, 3], colors[:, :3]
    )


def _read_compressed_ply(path: Path) -> Splats:
    """Read a compressed PLY, which quantises positions, log-scales and colours within their range in the chunk."""
    elements = read_elements(path)
    missing = {"chunk", "vertex"} - elements.keys()
    if missing:
        raise ValueError(
            f"{path}: found the elements {', '.join(elements)}, expected chunk and vertex; only PlayCanvas's "
            "compressed PLY is read here"
        )
    chunks, vertices = elements["chunk"], elements["vertex"]
    for name in _PACKED:
        if vertices.dtype.names is None or name not in vertices.dtype.names:
            raise ValueError(f"{path}: no property {name} of element vertex; expected {', '.join(_PACKED)}")
    if len(chunks) != -(-len(vertices) // _CHUNK):
        raise ValueError(
            f"{path}: found {len(chunks)} chunks for {len(vertices)} Gaussians, expected one for each {_CHUNK}"
        )
    chunk_of = np.arange(len(vertices)) // _CHUNK

    def within(units: np.ndarray, prefix: str, names: str) -> np.ndarray:
        low, high = (
            np.stack([_column(path, chunks, f"{end}_{prefix}{name}") for name in names], axis=1)[chunk_of]
            for end in ("min", "max")
        )
        return low + units * (high - low)

    colors = _units(vertices["packed_color"], (8, 8, 8, 8))
    # Files of the first version of the format have no colour range: colours span [0, 1].
    has_range = "min_r" in (chunks.dtype.names or ())
    return _splats(
        within(_units(vertices["packed_position"], (11, 10, 11)), "", "xyz"),
        _unpack_rotations(vertices["packed_rotation"]),
        np.exp(within(_units(vertices["packed_scale"], (11, 10, 11)), "scale_", "xyz")),
        colors[:, 3],
        within(colors[:, :3], "", "rgb") if has_range else colors[:, :3],
    )


def _column(path: Path, chunks: np.ndarray, name: str) -> np.ndarray:
    if name not in (chunks.dtype.names or ()):
        raise ValueError(f"{path}: no property {name} of element chunk, of which the format needs it")
    return np.asarray(chunks[name], dtype=np.float64)


def _units(packed: UInt32[np.ndarray, " N"], bits: tuple[int, ...]) -> Float[np.ndarray, "N fields"]:
    """Unpack bit fields, the highest bits first, each scaled to [0, 1]."""
    fields, shift = [], sum(bits)
    for width in bits:
        shift -= width
        largest = 2**width - 1
        fields.append(((packed >> np.uint32(shift)) & np.uint32(largest)) / largest)
    return np.stack(fields, axis=1)


def _unpack_rotations(packed: UInt32[np.ndarray, " N"]) -> Float[np.ndarray, "N 4"]:
    """Unit quaternions w x y z from 2 bits for the index of the largest component and 10 for each of the others."""
    others = (_units(packed & np.uint32(2**30 - 1), (10, 10, 10)) - 0.5) * np.sqrt(2)
    largest = np.sqrt(np.clip(1 - np.square(others).sum(axis=1), 0, None))
    index = (packed >> np.uint32(30)).astype(np.intp)
    is_largest = np.arange(4)[None, :] == index[:, None]
    quats = np.empty((len(packed), 4))
    quats[is_largest] = largest
    quats[~is_largest] = others.reshape(-1)
    return quats


def _splats(
    means: np.ndarray, quats: np.ndarray, scales: np.ndarray, opacities: np.ndarray, colors: np.ndarray
) -> Splats:
    return Splats(
        *(torch.from_numpy(np.array(value, np.float32)) for value in (means, quats, scales, opacities, colors))
    )
