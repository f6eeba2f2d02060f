"""The rasterizers to compare, ours and others, behind a common interface."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass

from opencl.bench import gsplat_peer, metal_gauss_peer
from opencl.contract import RasterOutput, RasterSettings
from opencl.rasterizer import rasterize

_INSTALL = "pip install --no-deps gsplat==1.5.3 metal-gauss==0.2.1"


@dataclass(frozen=True)
class Implementation:
    """A rasterizer and its constants."""

    name: str
    draw: Callable[..., RasterOutput]
    """Takes the arguments of `opencl.rasterizer.rasterize`, for one camera."""
    settings: RasterSettings
    package: str
    channels: int | None = None
    """Number of features that it draws at a time, on which it is measured. None if it draws any number."""
    largest: int | None = None
    """Largest number of Gaussians to measure: beyond it, a desktop computer would run out of memory."""
    differences: str = ""
    """Differences from ours with the same settings."""

    @property
    def is_installed(self) -> bool:
        return importlib.util.find_spec(self.package) is not None

    @property
    def how_to_install(self) -> str:
        return f"{self.name} is not installed: {_INSTALL}"


OURS = Implementation("ours", rasterize, RasterSettings(), "opencl")
PEERS = (
    Implementation(
        *("gsplat", gsplat_peer.rasterize_gsplat, gsplat_peer.SETTINGS, "gsplat"),
        largest=500_000,
        differences=(
            "its plain-torch reference, CUDA-only parts and Python loops given as vectorised torch; tiles farther than "
            "3.33 sigma are not drawn; the determinant of a needle's covariance cancels"
        ),
    ),
    Implementation(
        *("metal-gauss", metal_gauss_peer.rasterize_metal_gauss, metal_gauss_peer.SETTINGS, "metal_gauss"),
        channels=metal_gauss_peer.CHANNELS,
        largest=500_000,
        differences=(
            "its plain-torch reference, 16-pixel tiles; three features at a time; tiles farther than 3 sigma are not "
            "drawn; pixels are never finished early; the determinant of a needle's covariance cancels"
        ),
    ),
)


def implementation_named(name: str) -> Implementation:
    """The implementation of this name. Raises KeyError if there is none."""
    return {one.name: one for one in (OURS, *PEERS)}[name]
