"""Shadows fall where something stands in the light, and nooks see less of the sky than open ground."""

from __future__ import annotations

import numpy as np
import pytest

from stages.tracing.light import SHADOW_RESOLUTION, ShadowMap, SkyLight
from stages.tracing.shapes import Coordinates
from stages.tracing.tracer import Tracer
from tests.stages.tracing.worlds import builder, plain


def table() -> Tracer:
    """A table top over the ground, two units wide, one unit up."""
    build = builder()
    build.box((0, 0, 1.0), (1, 1, 0.05), plain(build))
    build.box((0, 0, -0.5), (9, 9, 0.5), plain(build))
    return Tracer(build.solids)


def points(*places: tuple[float, float, float]) -> Coordinates:
    x, y, z = np.array(places, np.float32).T
    return x, y, z


@pytest.mark.parametrize("resolution", [256, SHADOW_RESOLUTION])
def test_the_ground_under_a_table_is_in_its_shadow(resolution: int) -> None:
    shadow = ShadowMap(table(), (0.0, 0.0, 1.0), resolution)
    lit = shadow.lit(points((0, 0, 0.02), (0.9, -0.9, 0.02), (1.2, 0, 0.02), (-3, 2, 0.02), (0.3, 0.3, 1.07)))
    assert lit.tolist() == [0, 0, 1, 1, 1]


def test_a_low_sun_throws_the_shadow_aside() -> None:
    shadow = ShadowMap(table(), (2**-0.5, 0.0, 2**-0.5), SHADOW_RESOLUTION)
    lit = shadow.lit(points((-1, 0, 0.02), (0.3, 0, 0.02)))
    assert lit.tolist() == [0, 1]  # the table's shadow lies one unit away from the sun, from -2 to 0


def test_the_edge_of_a_shadow_is_soft() -> None:
    shadow = ShadowMap(table(), (0.0, 0.0, 1.0), 256)
    across = np.linspace(0.9, 1.1, 50, dtype=np.float32)
    lit = shadow.lit((across, np.zeros(50, np.float32), np.full(50, 0.02, np.float32)))
    assert (np.diff(lit) >= 0).all()
    assert ((lit > 0.05) & (lit < 0.95)).sum() > 5


def test_open_ground_has_the_whole_sky_and_a_nook_half() -> None:
    sky = SkyLight(table())
    places = points((4, 3, 0), (0, 0, 0), (1.05, 0, 0), (0, 0, 1.05))
    up = points(*[(0, 0, 1)] * 4)
    open_ground, nook, rim, top = sky(places, up)
    assert open_ground == pytest.approx(1, abs=0.1)
    assert top == pytest.approx(1, abs=0.15)
    # The table leaves the sky below 45 degrees, of which an upward surface gets sin²(45°) of its light.
    assert nook == pytest.approx(0.5, abs=0.1)
    assert nook < rim < open_ground


def test_light_from_above_falls_off_as_a_surface_turns_down() -> None:
    build = builder()
    build.box((0, 0, -0.5), (9, 9, 0.5), plain(build))
    sky = SkyLight(Tracer(build.solids))
    places, normals = points(*[(2, 2, 2)] * 3), points((0, 0, 1), (1, 0, 0), (0, 0, -1))
    ground, wall, ceiling = sky(places, normals)
    assert ground > 1.4 * wall > 2 * ceiling > 0
