"""Rejects implausible Gaussians before anything is made of them: splat files and containers may come from anyone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from pipeline.errors import UserError
from stages.scene.spherical_harmonics import SH_BASE, SH_REST

LARGEST = {"means": 1e9, "log_scales": 40.0, SH_BASE: 1e6, SH_REST: 1e6, "quats": 1e6}
"""Largest plausible magnitudes, for attributes whose names end in these, such as `message_sh_base`. Up to them,
covariances stay within float32's normal numbers. Other attributes only pass through a sigmoid."""
SMALLEST_QUATERNION = 1e-6
REMEDY = "Export the file again, or take those Gaussians out in an editor of splats."


def refuse_garbage(where: object, arrays: Mapping[str, Float[np.ndarray, "N ..."]]) -> None:
    """Raise `UserError` for no Gaussians, NaN, infinity, quaternions of length 0, or magnitudes beyond `LARGEST`.

    The error states how many Gaussians are affected, and the first. `arrays` are stored attributes, including `quats`.
    """
    if not len(arrays["quats"]):
        raise UserError("a file without Gaussians", where=where, found="0", expected="at least one")
    for name, array in arrays.items():
        rows = array.reshape(len(array), -1)
        limit = next((limit for ending, limit in LARGEST.items() if name.endswith(ending)), np.inf)
        _refuse(where, ~np.isfinite(rows).all(axis=1), f"{name} of NaN or infinity", rows, "finite numbers")
        _refuse(where, (np.abs(rows) > limit).any(axis=1), f"absurd {name}", rows, f"magnitudes up to {limit:g}")
    quats = arrays["quats"]
    short = np.linalg.norm(quats, axis=1) < SMALLEST_QUATERNION
    _refuse(where, short, "quaternions of no length", quats, "rotations w x y z")


def _refuse(where: object, wrong: Bool[np.ndarray, " N"], what: str, rows: np.ndarray, expected: str) -> None:
    if wrong.any():
        first = int(np.argmax(wrong))
        shown = ", ".join(f"{value:.6g}" for value in rows[first][:4])
        raise UserError(
            f"Gaussians with {what}",
            where=where,
            found=f"{int(wrong.sum())} of {len(wrong)}, the first in row {first}: {shown}",
            expected=expected,
            remedy=REMEDY,
        )
