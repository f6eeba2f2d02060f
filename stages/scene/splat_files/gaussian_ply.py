"""3DGS's own PLY: every stored value as a property of `vertex`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64, Shaped

from pipeline.errors import UserError
from stages.scene.splat_files.values import HARMONICS_OF_DEGREE, SplatValues

POSITION = ("x", "y", "z")
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
SCALE = ("scale_0", "scale_1", "scale_2")
COLOR = ("f_dc_0", "f_dc_1", "f_dc_2")
FILTER = "filter_3D"
"""Mip-Splatting's: the standard deviation of the smoothing that is applied to each Gaussian before it is drawn."""
NEEDED = (*POSITION, *COLOR, "opacity", *SCALE, *ROTATION)


def values_of_gaussian_ply(path: Path, vertices: Shaped[np.ndarray, " N"]) -> SplatValues:
    """Read the vertices of 3DGS; its `f_rest_*` list red, then green, then blue. Normals and the like are ignored.

    Mip-Splatting's filter becomes part of sizes and opacities, as in the file that it exports for other viewers. Raises
    `UserError` if properties are missing, or if the `f_rest_*` make up no whole degree of spherical harmonics.
    """
    names = vertices.dtype.names or ()
    missing = [name for name in NEEDED if name not in names]
    if missing:
        raise UserError(
            "a PLY that is not of 3D Gaussian Splatting",
            where=path,
            found=f"no {', '.join(missing[:4])} among {', '.join(name[:20] for name in names[:8]) or 'no properties'}",
            expected=f"an element vertex with {', '.join(NEEDED)}",
            remedy="Give the PLY that a training of 3DGS saved; a mesh or a point cloud will not do.",
        )
    rest = [name for name in names if name.startswith("f_rest_")]
    log_scales, logit_opacities = columns(vertices, SCALE), columns(vertices, ["opacity"])[:, 0]
    if FILTER in names:
        log_scales, logit_opacities = smoothed(log_scales, logit_opacities, columns(vertices, [FILTER]))
    return SplatValues(
        means=columns(vertices, POSITION),
        quats=columns(vertices, ROTATION),
        log_scales=log_scales,
        logit_opacities=logit_opacities,
        sh_base=columns(vertices, COLOR),
        sh_rest=by_harmonic(columns(vertices, names_of_rest(path, rest))),
    )


def smoothed(
    log_scales: Float[np.ndarray, "N 3"], logit_opacities: Float[np.ndarray, " N"], widths: Float[np.ndarray, "N 1"]
) -> tuple[Float64[np.ndarray, "N 3"], Float64[np.ndarray, " N"]]:
    """Log scales and opacity logits of N Gaussians after each is convolved with a round one of standard deviation.

    Variances add up along every axis, and the opacity falls as the volume grows, so that the integral stays the same.
    NaN and infinite widths give values that are not finite.
    """
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        grown = np.logaddexp(2 * log_scales.astype(np.float64), 2 * np.log(np.abs(widths.astype(np.float64)))) / 2
        log_opacities = (log_scales - grown).sum(axis=1) - np.logaddexp(0, -logit_opacities.astype(np.float64))
        return grown, log_opacities - np.log(-np.expm1(log_opacities))


def columns(rows: np.ndarray, names: Sequence[str]) -> Float[np.ndarray, "N C"]:
    """The named properties as columns, in float32; C = 0 is allowed."""
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, which is refused later
        return (
            np.stack([rows[name].astype(np.float32) for name in names], axis=1) if names else np.empty((len(rows), 0))
        )


def names_of_rest(path: Path, found: Sequence[str]) -> list[str]:
    """`f_rest_0` and so on, as many as were found. Raises `UserError` unless they make up a whole degree."""
    names = [f"f_rest_{number}" for number in range(len(found))]
    if len(found) not in HARMONICS_OF_DEGREE or set(names) != set(found):
        raise UserError(
            "spherical harmonics that do not make up a whole degree",
            where=path,
            found=f"{len(found)} properties f_rest_*",
            expected=f"f_rest_0 and on, {', '.join(map(str, HARMONICS_OF_DEGREE))} of them for the degrees 0 to 3",
        )
    return names


def by_harmonic(rest: Float[np.ndarray, "N columns"]) -> Float[np.ndarray, "N columns//3 3"]:
    """From all harmonics of each channel together, as in files, to the three channels of each harmonic together."""
    return rest.reshape(len(rest), 3, rest.shape[1] // 3).transpose(0, 2, 1)
