"""Scenes of small units are enlarged until what their cameras see is drawn."""

from __future__ import annotations

from opencl.rasterizer import RasterSettings
from stages.scene.drawn_depths import NEAR


def test_the_nearest_depth_is_the_rasterizers() -> None:
    assert RasterSettings().near == NEAR
