"""The text of OpenCL programs: which sources, with which constants."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from opencl.contract import RasterSettings

RESOURCES = ("kernels/*.cl", "kernels/cpu/*.cl", "kernels/gpu/*.cl")
"""Files beside this module that decide what it computes."""

TILE = 16
"""Side of a tile in pixels, as in real.cl."""

Schedule = Literal["cpu", "gpu"]
"""How work is cut: a tile for each work-item, or a tile for each work-group and a pixel for each of its work-items."""

Part = Literal["geometry", "blending", "harmonics", "ssim", "convolution", "pixel_decoder", "separation"]
"""Two programs draw a picture: what happens to Gaussians does not depend on how many features they have. The others do
what else a training step would spend its time on: colours of spherical harmonics, structural similarity, and, on the
CPU, decoders and their convolutions."""

_SOURCES: dict[tuple[Schedule, Part], tuple[str, ...]] = {
    ("cpu", "geometry"): ("real.cl", "projection.cl", "footprint.cl", "cpu/lanes.cl", "cpu/tiling.cl"),
    ("cpu", "blending"): (
        *("real.cl", "tile.cl", "cpu/lanes.cl", "cpu/blocks.cl"),
        *("cpu/blending.cl", "cpu/blending_backward.cl"),
    ),
    ("gpu", "geometry"): (
        *("real.cl", "projection.cl", "footprint.cl"),
        *("gpu/scanning.cl", "gpu/sorting.cl", "gpu/tiling.cl"),
    ),
    ("gpu", "blending"): (
        *("real.cl", "tile.cl", "gpu/splats.cl", "gpu/blending.cl"),
        *("gpu/blending_backward.cl", "gpu/gradient_sums.cl"),
    ),
    ("cpu", "harmonics"): ("real.cl", "harmonics.cl"),
    ("gpu", "harmonics"): ("real.cl", "harmonics.cl"),
    ("cpu", "ssim"): ("real.cl", "cpu/lanes.cl", "ssim.cl", "cpu/ssim.cl"),
    ("cpu", "convolution"): (
        *("real.cl", "cpu/lanes.cl", "cpu/products.cl"),
        *("cpu/winograd.cl", "cpu/convolution.cl"),
    ),
    ("cpu", "pixel_decoder"): (
        *("real.cl", "cpu/lanes.cl", "cpu/products.cl"),
        *("cpu/layers.cl", "cpu/pixel_decoder.cl"),
    ),
    ("cpu", "separation"): (
        *("real.cl", "cpu/lanes.cl", "cpu/products.cl"),
        *("cpu/layers.cl", "cpu/separation.cl"),
    ),
    ("gpu", "ssim"): ("real.cl", "ssim.cl", "gpu/ssim.cl"),
}
_KERNELS = Path(__file__).parent / "kernels"
_TEXTS = {name: (_KERNELS / name).read_text(encoding="utf-8") for names in _SOURCES.values() for name in names}
"""Read when this module is: a program that is built hours later is of the same sources, whatever was edited since."""

PROJECTION_CHUNK: dict[Schedule, int] = {"cpu": 128, "gpu": 1}
"""Gaussians that a work-item of the projection takes."""
PROJECTED_AT_ONCE: dict[Schedule, int] = {"cpu": 8, "gpu": 1}
"""Gaussians that it takes at a time, as a vector."""
GROUP_SIZE: dict[Schedule, int] = {"cpu": 1, "gpu": 256}
"""Work-items of a group; on the GPU schedule that is one for each pixel of a tile."""
TILING_RUNS = 32
"""Parts of the depth order that the CPU schedule counts into tiles side by side."""
SCAN_CHUNK = 1024
"""Values that a work-group of the GPU schedule's running sums takes."""
SORT_CHUNK = 2048
"""Items that a work-group of the GPU schedule's sort takes."""
SSIM_STRIP = 256
"""Values of a row, a multiple of 16, that a work-item of the CPU schedule's structural similarity takes."""
SSIM_COLUMNS = 98
"""Values of a row that a work-group of the GPU schedule's takes; what its window reaches makes them half the group."""
SSIM_ROWS = {torch.float32: 16, torch.float64: 8}
"""Rows that it takes, as many as 32 KiB of local memory have room for."""
SSIM_AT_ONCE: dict[Schedule, int] = {"cpu": 16, "gpu": 1}
"""Values that a work-item of the structural similarity takes at a time, as a vector."""
TILE_CHUNK = 16
"""Tiles, a multiple of 16, that a work-item of the convolutions takes at a time."""
PIXEL_CHUNK = 32
"""Pixels, a multiple of 16, that a work-item of the pixel decoders takes at a time."""


@dataclass(frozen=True)
class ProgramKey:
    """What a program is compiled for. `options` are names that its sources test with `#ifdef`."""

    part: Part
    schedule: Schedule
    dtype: torch.dtype
    settings: RasterSettings
    feature_dim: int = 1
    options: tuple[str, ...] = ()

    @property
    def needs_exact_rounding(self) -> bool:
        """Whether kernels that must agree to the last bit compute the same: two do so by footprint.cl, and what one
        counts the other writes, so that tiles beyond the count would be lost.

        `blend` and `blend_backward` compute the same alphas, too. By what gpu/splats.cl writes as fma there is nothing
        to contract in these, and the rest of both may be.
        """
        return self.part == "geometry"

    def text(self) -> str:
        """The whole source. Joined here, as drivers that cache programs do not see edits of included files."""
        reals = {
            "ALPHA_MINIMUM": self.settings.alpha_minimum,
            "ALPHA_MAXIMUM": self.settings.alpha_maximum,
            "TRANSMITTANCE_MINIMUM": self.settings.transmittance_minimum,
            "NEAR": self.settings.near,
            "LOW_PASS": self.settings.low_pass,
            "RADIUS_SIGMAS": self.settings.radius_sigmas,
        }
        integers = {
            "FEATURE_DIM": self.feature_dim,
            "PROJECTION_CHUNK": PROJECTION_CHUNK[self.schedule],
            "PROJECTED_AT_ONCE": PROJECTED_AT_ONCE[self.schedule],
            "GROUP_SIZE": GROUP_SIZE[self.schedule],
            "TILING_RUNS": TILING_RUNS,
            "SCAN_CHUNK": SCAN_CHUNK,
            "SORT_CHUNK": SORT_CHUNK,
            "SSIM_STRIP": SSIM_STRIP,
            "SSIM_COLUMNS": SSIM_COLUMNS,
            "SSIM_ROWS": SSIM_ROWS[self.dtype],
            "SSIM_AT_ONCE": SSIM_AT_ONCE[self.schedule],
            "TILE_CHUNK": TILE_CHUNK,
            "PIXEL_CHUNK": PIXEL_CHUNK,
        }
        lines = [f"#define {name} ((REAL){float(value)!r})" for name, value in reals.items()]
        lines += [f"#define {name} {value}" for name, value in integers.items()]
        lines += [f"#define {option}" for option in self.options]
        if self.needs_exact_rounding and self.schedule == "gpu":  # some drivers heed it outside of functions alone
            lines.append("#pragma OPENCL FP_CONTRACT OFF")
        if self.settings.antialiased:
            lines.append("#define ANTIALIASED")
        if self.dtype == torch.float64:
            lines.append("#define REAL_IS_DOUBLE")
        sources = _SOURCES[self.schedule, self.part]
        return "\n".join([*lines, *(_TEXTS[source] for source in sources)])
