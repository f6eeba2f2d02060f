"""Columns of Gaussians in a PLY file: 3DGS's names and order for attributes that it has, plain names for all others.

All values are raw, as they are stored and optimised. A description in words says which activation the renderer applies.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from pipeline.errors import UserError
from stages.scene.ply.reading import Ply
from stages.scene.spherical_harmonics import SH_BASE, SH_REST

VERTEX = "vertex"
NORMALS = ("nx", "ny", "nz")
"""3DGS writes zeros to these columns, and viewers of its files may rely on them."""


@dataclass(frozen=True)
class Layout:
    """The columns of one attribute and their activation; `*` in a name stands for the number of the column.

    With `colors_apart`, the last two axes [K, 3] are stored as [3, K]: all of red, then green, then blue.
    """

    names: str
    activation: str
    colors_apart: bool = False

    def columns(self, size: int) -> list[str]:
        """The names of `size` columns; names without `*` are fixed, whatever the size."""
        return (
            [self.names.replace("*", str(number)) for number in range(size)]
            if "*" in self.names
            else self.names.split()
        )


HARMONICS = "spherical harmonics of degree 1 and more in the order and signs of 3DGS, all of red, then green, then blue"
LAYOUTS = {
    "means": Layout("x y z", "position in the world, as it is"),
    SH_BASE: Layout("f_dc_*", "constant harmonic: colour = max(0, 0.5 + 0.28209479 value + what f_rest adds)"),
    SH_REST: Layout("f_rest_*", HARMONICS, colors_apart=True),
    "raw_features": Layout("feature_*", "sigmoid(value) is blended into the feature map that the scene decoder reads"),
    "logit_opacities": Layout("opacity", "opacity = sigmoid(value)"),
    "log_scales": Layout("scale_*", "standard deviation along the Gaussian's own axis = exp(value)"),
    "quats": Layout("rot_*", "rotation as a quaternion w x y z, to be normalised"),
}
FIRST, LAST = ("means", SH_BASE, SH_REST), ("logit_opacities", "log_scales", "quats")
"""3DGS's order of columns; attributes that it does not have come in between."""


def layout_of(attribute: str) -> Layout:
    """The layout of an attribute; one that 3DGS does not have gets columns under its own name."""
    return LAYOUTS.get(attribute) or Layout(f"{attribute}_*", "as the method stores it")


def in_order(attributes: Sequence[str]) -> list[str]:
    """Attributes in the order of their columns.

    >>> in_order(["quats", "raw_features", "means", "log_scales", "logit_opacities"])
    ['means', 'raw_features', 'logit_opacities', 'log_scales', 'quats']
    """
    between = sorted(set(attributes) - {*FIRST, *LAST})
    return [name for name in (*FIRST, *between, *LAST) if name in attributes]


def columns_of(attributes: Mapping[str, Float32[np.ndarray, "N ..."]]) -> dict[str, Float32[np.ndarray, " N"]]:
    """The columns of all attributes; N = 0 is allowed. Harmonics give exactly 3DGS's columns, normals included.

    Raises `ValueError` if two attributes would have the same column.
    """
    columns: dict[str, Float32[np.ndarray, " N"]] = {}
    for name in in_order(list(attributes)):
        layout, values = layout_of(name), attributes[name]
        if layout.colors_apart:
            values = values.swapaxes(-1, -2)
        flat = values.reshape(len(values), math.prod(values.shape[1:]))
        added = dict(zip(layout.columns(flat.shape[1]), flat.T, strict=True))
        if name == "means" and SH_BASE in attributes:
            added |= {normal: np.zeros(len(values), np.float32) for normal in NORMALS}
        if added.keys() & columns.keys():
            raise ValueError(
                f"attribute {name!r} has columns of another's names: {sorted(added.keys() & columns.keys())}"
            )
        columns |= added
    return columns


def attribute_of(ply: Ply, name: str, shape: tuple[int, ...]) -> Float32[np.ndarray, "N ..."]:
    """An attribute [N, *shape], assembled from its columns.

    Raises `UserError` if a column is missing, has another type or is not finite, and for a shape that the attribute
    cannot have.
    """
    layout = layout_of(name)
    names = layout.columns(math.prod(shape))
    if len(names) != math.prod(shape) or (layout.colors_apart and len(shape) < 2):
        raise UserError(
            f"an attribute {name!r} of another shape", where=ply.path, found=shape, expected=f"columns {layout.names}"
        )
    stored = (*shape[:-2], shape[-1], shape[-2]) if layout.colors_apart else shape
    values = ply.floats(VERTEX, names)
    values = values.reshape(len(values), *stored)
    return np.ascontiguousarray(values.swapaxes(-1, -2)) if layout.colors_apart else values


def activations(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, str]:
    """For each group of columns, in order, how the renderer activates the raw values.

    >>> activations({"quats": (4,), "logit_opacities": ()})["rot_0 to rot_3"]
    'rotation as a quaternion w x y z, to be normalised'
    """
    said = {}
    for name in in_order(list(shapes)):
        layout = layout_of(name)
        columns = layout.columns(math.prod(shapes[name]))
        if columns:
            said[f"{columns[0]} to {columns[-1]}" if "*" in layout.names else layout.names] = layout.activation
    return said
