"""Small files of random splats in every format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plyfile
from numpy.typing import ArrayLike

CHUNK_RANGES = ["x", "y", "z", "scale_x", "scale_y", "scale_z", "r", "g", "b"]
PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
REST = {0: 0, 1: 9, 2: 24, 3: 45}


def columns(count: int, degree: int, seed: int = 0) -> dict[str, np.ndarray]:
    """The properties of 3DGS's PLY, normals included, in its order."""
    generator = np.random.default_rng(seed)
    names = [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(REST[degree]))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    return {name: generator.normal(size=count).astype(np.float32) for name in names}


def write_ply(path: Path, table: dict[str, np.ndarray], byte_order: str = "<", text: bool = False) -> Path:
    """Write one element `vertex` with plyfile, the package that 3DGS itself uses."""
    rows = np.empty(len(next(iter(table.values()))), [(name, column.dtype) for name, column in table.items()])
    for name, column in table.items():
        rows[name] = column
    element = plyfile.PlyElement.describe(rows, "vertex")
    plyfile.PlyData([element], text=text, byte_order="=" if text else byte_order).write(str(path))
    return path


def pack(values: list[int], bits: tuple[int, ...]) -> int:
    """Pack fields into one integer, the first in the highest bits."""
    packed = 0
    for value, width in zip(values, bits, strict=True):
        assert 0 <= value < 2**width
        packed = packed << width | value
    return packed


def compressed_ply(
    vertices: list[list[int]], chunks: list[list[float]], colored: bool = True, harmonics: ArrayLike | None = None
) -> bytes:
    """`vertices` are as in PACKED; each chunk has the smallest, then the largest values, in CHUNK_RANGES's order."""
    ranges = CHUNK_RANGES if colored else CHUNK_RANGES[:6]
    header = [
        *("ply", "format binary_little_endian 1.0", "comment by a test", f"element chunk {len(chunks)}"),
        *(f"property float {end}_{name}" for end in ("min", "max") for name in ranges),
        f"element vertex {len(vertices)}",
        *(f"property uint {name}" for name in PACKED),
    ]
    body = np.array(chunks, "<f4").tobytes() + np.array(vertices, "<u4").tobytes()
    if harmonics is not None:
        rows = np.array(harmonics, "u1")
        header += [f"element sh {len(rows)}", *(f"property uchar f_rest_{number}" for number in range(rows.shape[1]))]
        body += rows.tobytes()
    return "\n".join([*header, "end_header\n"]).encode() + body


def records(count: int = 3) -> np.ndarray:
    """Rows of a `.splat`."""
    rows = np.zeros(count, [("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("quat", "u1", 4)])
    rows["mean"] = np.arange(3 * count).reshape(count, 3)
    rows["scale"] = [0.5, 0.25, 0.125]
    rows["color"] = [255, 0, 51, 102]
    rows["quat"] = [192, 128, 64, 0]
    return rows
