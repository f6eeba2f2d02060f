"""Pictures against the float64 reference, which is plain torch and shares no code with the kernels."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from opencl.contract import RasterSettings
from tests.opencl.scenes import make_scene, near_a_threshold, one_gaussian

pytestmark = pytest.mark.usefixtures("both_schedules")

GSPLAT = RasterSettings(near=0.01, alpha_maximum=0.999, radius_sigmas=3.33, clamp_about="principal_point")


@pytest.mark.parametrize("feature_dim", [1, 3, 8, 16, 17, 32])
@pytest.mark.parametrize("size", [(37, 29), (8, 8), (16, 32)])
def test_float64_is_the_reference(feature_dim, size):
    scene = make_scene(feature_dim=feature_dim, width=size[0], height=size[1])
    drawn, expected = scene.draw(), scene.draw_reference()
    torch.testing.assert_close(drawn.features, expected.features, rtol=1e-12, atol=1e-13)
    torch.testing.assert_close(drawn.alphas, expected.alphas, rtol=1e-12, atol=1e-13)
    torch.testing.assert_close(drawn.means2d, expected.means2d, rtol=1e-13, atol=1e-12)
    assert torch.equal(drawn.radii, expected.radii)
    assert drawn.features.shape == (size[1], size[0], feature_dim)
    assert drawn.features.is_contiguous()
    assert drawn.radii.dtype == torch.int32


@pytest.mark.parametrize("feature_dim", [3, 16])
def test_float32_is_the_reference_away_from_thresholds(feature_dim):
    scene = make_scene(count=300, feature_dim=feature_dim, width=83, height=50, size=0.1, dtype=torch.float32)
    drawn, expected = scene.draw(), scene.to(torch.float64).draw_reference()
    sound = ~near_a_threshold(scene)
    assert sound.double().mean() > 0.5
    difference = drawn.features.double() - expected.features
    assert difference[sound].abs().max() < 2e-6
    assert (drawn.alphas - expected.alphas)[sound].abs().max() < 2e-6
    # At a threshold, a Gaussian of alpha 1/255, or what remains below 1e-4, may be drawn or not, equally often.
    assert difference.abs().max() < 2 / 255
    assert difference.mean().abs() < 1e-5


@pytest.mark.parametrize(
    "settings",
    [GSPLAT, RasterSettings(low_pass=0.1, alpha_minimum=0.02), RasterSettings(field_of_view_margin=0.4)],
    ids=["gsplat", "other", "narrow"],
)
def test_settings_reach_the_kernels(settings):
    scene = make_scene(count=80, settings=settings, size=0.4)
    drawn, expected = scene.draw(), scene.draw_reference()
    torch.testing.assert_close(drawn.features, expected.features, rtol=1e-11, atol=1e-12)
    assert torch.equal(drawn.radii, expected.radii)
    plain = make_scene(count=80, size=0.4).draw()
    assert not torch.equal(drawn.features, plain.features)


def test_fewer_pixels_are_some_of_the_whole_picture():
    whole = make_scene(count=80, width=81, height=60, size=0.1)
    smaller = torch.diag(torch.tensor([1 / 3, 1 / 3, 1.0], dtype=torch.float64))
    fewer = replace(
        whole,
        intrinsics=smaller @ whole.intrinsics,
        width=27,
        height=20,
        settings=whole.settings.for_fewer_pixels(1 / 3),
    )
    torch.testing.assert_close(fewer.draw().features, whole.draw().features[1::3, 1::3], rtol=1e-10, atol=1e-12)
    assert RasterSettings().for_fewer_pixels(1e-9).low_pass > 0


def test_one_gaussian_by_hand():
    scene = one_gaussian(opacity=0.5)
    drawn = scene.draw()
    variance = (20 * 0.2 / 2) ** 2 + 0.3
    expected = 0.5 * math.exp(-0.5 * (0.5**2 + 1.5**2) / variance)
    assert drawn.features[10, 10, 0].item() == pytest.approx(expected, rel=1e-12)
    assert drawn.alphas[10, 10].item() == pytest.approx(expected, rel=1e-12)
    assert drawn.means2d.tolist() == [[10.0, 9.0]]
    assert drawn.radii.item() == math.ceil(3 * math.sqrt(variance))


def test_a_gaussian_reaches_past_three_sigma():
    drawn = one_gaussian(centre=(-0.41, 0.05, 2.0), scales=(0.1, 0.1, 0.0), opacity=1.0).draw()
    sigma = math.sqrt(1.3)
    reached = drawn.alphas[9] > 0
    furthest = reached.nonzero().max().item() + 0.5 - drawn.means2d[0, 0].item()
    assert 3 * sigma < furthest <= sigma * math.sqrt(2 * math.log(255))


def test_equal_depths_are_drawn_by_index():
    scene = make_scene(count=40, size=0.6)
    scene.means.copy_(scene.means[:1].expand(40, 3))
    torch.testing.assert_close(scene.draw().features, scene.draw_reference().features, rtol=1e-12, atol=1e-13)
    reversed_scene = scene.only(torch.arange(39, -1, -1))
    assert not torch.allclose(scene.draw().features, reversed_scene.draw().features)


def test_order_of_gaussians_does_not_matter_where_depths_differ():
    scene = make_scene(count=200, dtype=torch.float32)
    shuffled = scene.only(torch.randperm(200, generator=torch.Generator().manual_seed(1)))
    assert torch.equal(scene.draw().features, shuffled.draw().features)


@pytest.mark.parametrize("opacity", [0.99, 1.0])
def test_opaque_layers_stop_and_background_shows_through(opacity):
    scene = make_scene(count=300, size=1.0, opacity=(opacity, opacity))
    drawn, expected = scene.draw(), scene.draw_reference()
    torch.testing.assert_close(drawn.features, expected.features, rtol=1e-11, atol=1e-12)
    assert drawn.alphas.max() < 1


def test_many_channels_are_blended_in_passes():
    scene = make_scene(count=20, feature_dim=134)
    torch.testing.assert_close(scene.draw().features, scene.draw_reference().features, rtol=1e-12, atol=1e-13)


def test_no_background_is_black():
    scene = make_scene()
    from opencl.rasterizer import rasterize

    drawn = rasterize(*scene.gaussians, *scene.camera)
    black = rasterize(*scene.gaussians, *scene.camera, torch.zeros_like(scene.background))
    assert torch.equal(drawn.features, black.features)
