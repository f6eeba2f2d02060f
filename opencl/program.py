"""Assembles the text of OpenCL programs from their sources and constants."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from opencl.contract import RasterSettings

RESOURCES = ("kernels/*.cl", "kernels/cpu/*.cl", "kernels/gpu/*.cl")
"""Files beside this module that determine its results."""

TILE = 16
"""Side of a tile in pixels, as in real.cl."""

Schedule = Literal["cpu", "gpu"]
"""Division of work: a tile per work-item ("cpu"), or a tile per work-group and a pixel per work-item ("gpu")."""

Part = Literal["geometry", "blending", "harmonics", "ssim", "convolution", "pixel_decoder", "separation"]
"""Two programs draw a picture: "geometry", which does not depend on the number of features, and "blending". The others
compute what else takes time in a training step: colours from spherical harmonics, structural similarity and, on the
CPU, decoders, their convolutions and the separation penalty."""

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
"""Read on import, so that programs built hours later use the same sources, even if files were edited since."""

PROJECTION_CHUNK: dict[Schedule, int] = {"cpu": 128, "gpu": 1}
"""Gaussians per work-item of the projection and of the spherical harmonics."""
PROJECTED_AT_ONCE: dict[Schedule, int] = {"cpu": 8, "gpu": 1}
"""Gaussians that the projection processes at a time, as a vector."""
GROUP_SIZE: dict[Schedule, int] = {"cpu": 1, "gpu": 256}
"""Work-items per group. On the GPU schedule, one for each pixel of a tile."""
TILING_RUNS = 32
"""Parts of the depth order that the CPU schedule sorts into tiles in parallel."""
SCAN_CHUNK = 1024
"""Values per work-group of the GPU schedule's prefix sums."""
SORT_CHUNK = 2048
"""Items per work-group of the GPU schedule's sort."""
SSIM_STRIP = 256
"""Values of a row, a multiple of 16, per work-item of the CPU schedule's structural similarity."""
SSIM_COLUMNS = 98
"""Values of a row per work-group of the GPU schedule's. With 15 on either side for the window: half GROUP_SIZE."""
SSIM_ROWS = {torch.float32: 16, torch.float64: 8}
"""Rows per work-group of the GPU schedule's: as many as fit into 32 KiB of local memory."""
SSIM_AT_ONCE: dict[Schedule, int] = {"cpu": 16, "gpu": 1}
"""Values that the structural similarity processes at a time, as a vector."""
TILE_CHUNK = 16
"""Tiles, a multiple of 16, that a work-item of the convolutions processes at a time."""
PIXEL_CHUNK = 32
"""Pixels of the pixel decoders, or Gaussians of the separation, per work-item at a time: a multiple of 16."""


@dataclass(frozen=True)
class ProgramKey:
    """All that determines a program. `options` are macros that its sources test with `#ifdef`."""

    part: Part
    schedule: Schedule
    dtype: torch.dtype
    settings: RasterSettings
    feature_dim: int = 1
    options: tuple[str, ...] = ()

    @property
    def needs_exact_rounding(self) -> bool:
        """Whether different kernels must compute the same bits, so that no multiply-add may be contracted to an fma.

        In "geometry", one kernel counts the tiles of a Gaussian by footprint.cl and another writes them: tiles beyond
        the count would be lost. `blend` and `blend_backward` must compute the same alphas, too, but gpu/splats.cl
        writes these with explicit fma, which leaves nothing to contract. The rest of both kernels may be contracted.
        """
        return self.part == "geometry"

    def text(self) -> str:
        """The whole source. Joined here, because drivers that cache programs miss changes of included files."""
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
        if self.needs_exact_rounding and self.schedule == "gpu":  # some drivers heed it only outside of functions
            lines.append("#pragma OPENCL FP_CONTRACT OFF")
        if self.settings.antialiased:
            lines.append("#define ANTIALIASED")
        if self.dtype == torch.float64:
            lines.append("#define REAL_IS_DOUBLE")
        sources = _SOURCES[self.schedule, self.part]
        return "\n".join([*lines, *(_TEXTS[source] for source in sources)])
