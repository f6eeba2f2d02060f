"""Comparison with rasterizers that we did not write: the plain-torch references of gsplat and metal-gauss."""

from __future__ import annotations

import pytest
import torch

from opencl.bench.gsplat_peer import SETTINGS as GSPLAT
from opencl.bench.gsplat_peer import rasterize_gsplat
from opencl.bench.metal_gauss_peer import SETTINGS as METAL_GAUSS
from opencl.bench.metal_gauss_peer import rasterize_metal_gauss
from opencl.contract import RasterSettings
from opencl.rasterizer import rasterize
from tests.opencl.comparison import (
    FLOAT32,
    FLOAT64,
    compare_gradients,
    compare_pictures,
    discontinuities_of,
    gradients_from,
)
from tests.opencl.scenes import Scene, make_scene

FEATURE_DIMS = (1, 3, 8, 16, 17, 32, 64, 128)
BASIC_DIMS = (3, 17)  # a picture's, and one that is no multiple of a vector's lanes
PEERS = {"gsplat": (rasterize_gsplat, GSPLAT, None), "metal_gauss": (rasterize_metal_gauss, METAL_GAUSS, 3.0)}
TOLERANCES = {torch.float32: FLOAT32, torch.float64: FLOAT64}


def scene_for(settings: RasterSettings, feature_dim: int, dtype: torch.dtype, **changes) -> Scene:
    shape = {"count": 100, "width": 61, "height": 43, "size": 0.12, "seed": feature_dim} | changes
    return make_scene(feature_dim=feature_dim, dtype=dtype, settings=settings, **shape)


def compare(peer: str, scene: Scene) -> None:
    pytest.importorskip(peer)
    draw, _, cut_sigmas = PEERS[peer]
    tolerance = TOLERANCES[scene.means.dtype]
    at = discontinuities_of(scene, tolerance, cut_sigmas)
    expected = draw(*scene.gaussians, *scene.camera, scene.background, scene.settings)
    found = scene.draw()
    assert expected.features.shape == found.features.shape
    assert found.alphas.max() > 0.5, "hardly anything is drawn"
    compare_pictures(found, expected, scene, at, tolerance)
    everywhere = torch.ones_like(at.smooth)
    for pixels, relative in ((at.smooth, tolerance.gradients), (everywhere, tolerance.gradients_at_thresholds)):
        if pixels is everywhere and cut_sigmas is not None:
            continue  # what is cut off does not depend on rounding
        compare_gradients(gradients_from(rasterize, scene, pixels), gradients_from(draw, scene, pixels), relative)


@pytest.mark.parametrize(
    ("feature_dim", "dtype"),
    [
        pytest.param(dim, dtype, marks=() if dim in BASIC_DIMS else pytest.mark.slow)
        for dtype in TOLERANCES
        for dim in FEATURE_DIMS
    ],
    ids=str,
)
@pytest.mark.parametrize("peer", PEERS)
def test_pictures_and_gradients_agree(peer, feature_dim, dtype):
    compare(peer, scene_for(PEERS[peer][1], feature_dim, dtype))


@pytest.mark.parametrize("size", [(16, 32), (15, 17), (1, 40), (95, 3)])
@pytest.mark.parametrize("peer", PEERS)
def test_pictures_of_any_size(peer, size):
    compare(peer, scene_for(PEERS[peer][1], 3, torch.float64, width=size[0], height=size[1], size=0.3))


@pytest.mark.parametrize("peer", PEERS)
def test_opaque_layers(peer):
    # Not so opaque that the rest of the background is lost when a peer sums shares up to 1.
    compare(peer, scene_for(PEERS[peer][1], 3, torch.float64, count=100, size=0.25, opacity=(0.9, 1.0)))


@pytest.mark.parametrize("peer", PEERS)
def test_a_principal_point_far_off_the_middle(peer):
    scene = scene_for(PEERS[peer][1], 3, torch.float64, size=0.3)
    scene.intrinsics[:2, 2] += torch.tensor([40.0, -25.0], dtype=torch.float64)
    compare(peer, scene)


@pytest.mark.parametrize("peer", PEERS)
def test_a_peer_says_which_constants_it_has(peer):
    draw = PEERS[peer][0]
    scene = scene_for(RasterSettings(low_pass=0.1), 3, torch.float32)
    with pytest.raises(ValueError, match=r"settings: found .*low_pass=0\.1"):
        draw(*scene.gaussians, *scene.camera, scene.background, scene.settings)
