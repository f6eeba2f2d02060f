"""What every format is turned into: 3DGS's stored values, checked, whoever wrote the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8

from pipeline.errors import UserError
from stages.scene.gaussians import Gaussians
from stages.scene.spherical_harmonics import BASE

LARGEST_LOGIT = 30.0
"""Beyond this, float32's sigmoid is 0 or 1. Programs that store opacities as bytes write infinity for 0 and 255."""
LARGEST = {"means": 1e9, "log_scales": 40.0, "sh_base": 1e6, "sh_rest": 1e6, "quats": 1e6}
"""Magnitudes beyond which a file is garbage; up to these, covariances stay within float32's normal numbers."""
SMALLEST_QUATERNION = 1e-6
REMEDY = "Export the file again, or take those Gaussians out in an editor of splats."

HARMONICS_OF_DEGREE = {0: 0, 9: 1, 24: 2, 45: 3}
"""Degree of the spherical harmonics by how many numbers there are beside the constant ones: 3 ((degree + 1)² - 1)."""


@dataclass(frozen=True)
class SplatValues:
    """N Gaussians in 3DGS's stored form, K = (degree + 1)²; quaternions are w x y z, of any length."""

    means: Float[np.ndarray, "N 3"]
    quats: Float[np.ndarray, "N 4"]
    log_scales: Float[np.ndarray, "N 3"]
    logit_opacities: Float[np.ndarray, " N"]
    sh_base: Float[np.ndarray, "N 3"]
    sh_rest: Float[np.ndarray, "N K-1 3"]


def gaussians_of(path: Path, values: SplatValues) -> Gaussians:
    """The values as Gaussians of the method `plain`, in float32; opacities of exactly 0 or 1 become nearly so.

    Raises `UserError` for a file of no Gaussians, NaN, infinity, quaternions of no length and magnitudes that no scene
    has, and says how many Gaussians are so and which is the first.
    """
    if not len(values.means):
        raise UserError("a file without Gaussians", where=path, found="0", expected="at least one")
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, which is refused
        arrays = {name: np.ascontiguousarray(array, np.float32) for name, array in vars(values).items()}
    arrays["logit_opacities"] = arrays["logit_opacities"].clip(-LARGEST_LOGIT, LARGEST_LOGIT)  # NaN stays
    _refuse_garbage(path, arrays)
    return Gaussians({name: torch.from_numpy(array) for name, array in arrays.items()})


def _refuse_garbage(path: Path, arrays: Mapping[str, Float[np.ndarray, "N ..."]]) -> None:
    for name, array in arrays.items():
        rows = array.reshape(len(array), -1)
        limit = LARGEST.get(name, np.inf)
        _refuse(path, ~np.isfinite(rows).all(axis=1), f"{name} of NaN or infinity", rows, "finite numbers")
        _refuse(path, (np.abs(rows) > limit).any(axis=1), f"absurd {name}", rows, f"magnitudes up to {limit:g}")
    quats = arrays["quats"]
    short = np.linalg.norm(quats, axis=1) < SMALLEST_QUATERNION
    _refuse(path, short, "quaternions of no length", quats, "rotations w x y z")


def _refuse(path: Path, wrong: Bool[np.ndarray, " N"], what: str, rows: np.ndarray, expected: str) -> None:
    if wrong.any():
        first = int(np.argmax(wrong))
        shown = ", ".join(f"{value:.6g}" for value in rows[first][:4])
        raise UserError(
            f"Gaussians with {what}",
            where=path,
            found=f"{int(wrong.sum())} of {len(wrong)}, the first in row {first}: {shown}",
            expected=expected,
            remedy=REMEDY,
        )


def base_of_colors(colors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """The constant harmonics of colours that are the same from everywhere."""
    return (colors - 0.5) / BASE


def logits_of_bytes(opacities: UInt8[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Logits of opacities in 255ths; 0 and 255 count as a quarter of a step from the end."""
    shares = (opacities / 255).clip(0.25 / 255, 1 - 0.25 / 255)
    return np.log(shares / (1 - shares))
