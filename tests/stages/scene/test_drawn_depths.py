"""Scenes of small units are enlarged until the rasterizer draws what their cameras see."""

from __future__ import annotations

from opencl.rasterizer import RasterSettings
from stages.scene.drawn_depths import NEAR


def test_the_nearest_depth_is_the_rasterizers() -> None:
    assert RasterSettings().near == NEAR
