"""`.splat`: 32 bytes per Gaussian, without a header."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.errors import UserError
from stages.scene.splat_files.values import SplatValues, base_of_colors, logits_of_bytes

RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("quat", "u1", 4)])
"""Position, standard deviations, colour and opacity in 255ths, and (q + 1) · 128 for each component w x y z."""


def values_of_records(path: Path) -> SplatValues:
    """The Gaussians of a `.splat` file. Raises `UserError` for a partial record, or scales that are not positive."""
    size = path.stat().st_size
    if size % RECORD.itemsize:
        raise UserError(
            "a file of splats of no known format",
            where=path,
            found=f"{size} bytes that do not begin as a PLY",
            expected=f"a PLY, or a .splat of {RECORD.itemsize} bytes for each Gaussian",
            remedy="Export it as PLY; if it should be a .splat, it is cut off: fetch it again.",
        )
    records = np.memmap(path, RECORD, "r") if size else np.empty(0, RECORD)
    scales = records["scale"].astype(np.float64)
    if not (scales > 0).all():
        raise UserError(
            "a .splat with Gaussians of no size",
            where=path,
            found=f"{int((~(scales > 0)).any(axis=1).sum())} of {len(records)}",
            expected="standard deviations above 0",
            remedy="Is it a .splat at all? Other formats are exported as PLY first.",
        )
    return SplatValues(
        means=records["mean"],
        quats=(records["quat"].astype(np.float32) - 128) / 128,
        log_scales=np.log(scales),
        logit_opacities=logits_of_bytes(records["color"][:, 3]),
        sh_base=base_of_colors(records["color"][:, :3] / 255),
        sh_rest=np.empty((len(records), 0, 3)),
    )
