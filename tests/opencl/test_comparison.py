"""Tests of the comparison itself: it accepts differences by rounding, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from opencl.contract import RasterSettings
from opencl.rasterizer import rasterize
from opencl.reference import rasterize_reference
from tests.opencl.comparison import (
    FLOAT32,
    NAMES,
    compare_gradients,
    compare_pictures,
    discontinuities_of,
    gradients_from,
)
from tests.opencl.discontinuities import find_discontinuities
from tests.opencl.scenes import Scene, make_scene, one_gaussian


def sample_scene(seed: int = 0, **changes) -> Scene:
    return make_scene(
        seed=seed, dtype=torch.float32, **({"count": 150, "width": 61, "height": 43, "size": 0.12} | changes)
    )


def compare(scene: Scene, other: Scene) -> None:
    """Compare `other`, drawn by float32 kernels, with the float64 reference's picture of `scene`."""
    expected = scene.to(torch.float64).draw_reference()
    compare_pictures(other.draw(), expected, scene, discontinuities_of(scene, FLOAT32), FLOAT32)


def jittered(scene: Scene, relative: float) -> Scene:
    """The scene with noise of this relative size on all values of its Gaussians."""
    random = torch.Generator().manual_seed(1)
    changed = {
        name: getattr(scene, name) * (1 + relative * torch.randn(getattr(scene, name).shape, generator=random))
        for name in ("means", "quats", "scales", "opacities", "features")
    }
    return replace(scene, **changed)


@pytest.mark.parametrize("seed", range(4))
def test_rounding_is_accepted(seed):
    compare(sample_scene(seed), sample_scene(seed))
    compare(sample_scene(seed), jittered(sample_scene(seed), 1e-7))


def test_rounding_at_the_end_of_pixels_is_accepted():
    scene = sample_scene(size=0.6, opacity=(0.5, 1.0), count=300)
    assert scene.draw().alphas.max() > 0.9998
    compare(scene, jittered(scene, 1e-7))


def test_another_order_of_equal_depths_is_accepted():
    scene = sample_scene(count=40, size=0.3)
    scene.means.copy_(scene.means[:1] + 0.4 * (scene.means - scene.means[:1]))
    into_view = scene.world_to_camera[2, :3]
    scene.means.sub_(((scene.means @ into_view) - scene.means[0] @ into_view)[:, None] * into_view)
    swapped = scene.only(torch.arange(39, -1, -1))
    difference = (scene.draw().features - swapped.draw().features).abs().max()
    assert difference > 100 * FLOAT32.values
    at = find_discontinuities(scene, FLOAT32.margin, FLOAT32.depth_margin)
    compare_pictures(swapped.draw(), scene.draw(), scene, at, FLOAT32)


def test_a_cut_radius_is_accepted_where_it_is_named_and_only_as_a_lack():
    scene = one_gaussian(scales=(0.1, 0.1, 0.0), opacity=1.0, width=40, height=36, dtype=torch.float32)
    whole = scene.draw()
    rows, columns = torch.meshgrid(torch.arange(36) + 0.5, torch.arange(40) + 0.5, indexing="ij")
    sigma = (1 + 0.3) ** 0.5
    inside = torch.maximum((rows - 18).abs(), (columns - 20).abs()) < 3 * sigma
    assert (whole.alphas[~inside] > 0).any()
    cut = replace(whole, features=whole.features * inside[..., None], alphas=whole.alphas * inside)
    at = find_discontinuities(scene, FLOAT32.margin, cut_sigmas=3.0)
    compare_pictures(whole, cut, scene, at, FLOAT32)
    with pytest.raises(AssertionError, match="lack what is drawn"):
        compare_pictures(cut, whole, scene, at, FLOAT32)
    with pytest.raises(AssertionError, match="differ by"):
        compare_pictures(whole, cut, scene, find_discontinuities(scene, FLOAT32.margin), FLOAT32)


def shifted(scene: Scene) -> Scene:
    intrinsics = scene.intrinsics.clone()
    intrinsics[0, 2] += 0.5
    return replace(scene, intrinsics=intrinsics)


def without_one(scene: Scene) -> Scene:
    """The scene without the faintest of its visible Gaussians."""
    visible = (scene.draw().radii > 0).nonzero().squeeze(-1)
    faintest = visible[scene.opacities[visible].argmin()]
    return scene.only(torch.arange(len(scene.means)) != faintest)


@pytest.mark.parametrize(
    "change",
    [
        lambda scene: replace(scene, opacities=scene.opacities * 0.99),
        shifted,
        without_one,
        lambda scene: replace(scene, scales=scene.scales * 1.01),
        lambda scene: replace(scene, background=scene.background + 0.001),
        lambda scene: replace(scene, settings=replace(scene.settings, alpha_minimum=1 / 250)),
        lambda scene: replace(scene, settings=replace(scene.settings, low_pass=0.31)),
    ],
    ids=["opacities", "half a pixel", "one missing", "scales", "background", "threshold", "low pass"],
)
@pytest.mark.parametrize("seed", range(3))
def test_errors_are_rejected(change, seed):
    scene = sample_scene(seed)
    with pytest.raises(AssertionError, match="differ by"):
        compare(scene, change(scene))


@pytest.mark.parametrize("factor", [1 - 8e-4, 1 + 8e-4])
def test_a_bias_too_small_for_any_single_pixel_is_rejected(factor):
    scene = sample_scene(count=500, width=120, height=90, size=0.3, opacity=(0.01, 0.05))
    compare(scene, scene)
    biased = replace(scene, settings=replace(scene.settings, alpha_minimum=scene.settings.alpha_minimum * factor))
    with pytest.raises(AssertionError, match="biased at thresholds"):
        compare(scene, biased)


def test_gradients_that_differ_by_rounding_are_accepted():
    scene = sample_scene()
    at = discontinuities_of(scene, FLOAT32)
    for pixels, relative in ((at.smooth, FLOAT32.gradients), (torch.ones_like(at.smooth), 0.02)):
        found, expected = (
            gradients_from(draw, given, pixels)
            for draw, given in ((rasterize, scene), (rasterize_reference, scene.to(torch.float64)))
        )
        compare_gradients(found, expected, relative)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "spoil",
    [lambda one: one * 1.001, torch.neg, torch.zeros_like, lambda one: one.roll(1, dims=0) + one.roll(1, dims=-1)],
    ids=["a thousandth", "sign", "missing", "another place"],
)
def test_a_wrong_gradient_of_one_input_is_rejected(name, spoil):
    scene = sample_scene()
    right = gradients_from(rasterize, scene, discontinuities_of(scene, FLOAT32).smooth)
    with pytest.raises(AssertionError, match=f"gradient of {name}"):
        compare_gradients(right | {name: spoil(right[name])}, right, FLOAT32.gradients)


def test_a_gradient_where_there_is_none_is_rejected():
    nothing = {"means": torch.zeros(3, 3)}
    compare_gradients(nothing, nothing, 1e-4)
    with pytest.raises(AssertionError, match="gradient of means"):
        compare_gradients({"means": torch.full((3, 3), 0.1)}, nothing, 1e-4)


def test_the_clamp_of_alpha_is_a_kink_and_no_step():
    settings = RasterSettings()
    scene = one_gaussian(
        centre=(0.05, 0.05, 2.0), opacity=settings.alpha_maximum, settings=settings
    )  # on a pixel's centre
    at = find_discontinuities(scene, 1e-3)
    assert at.kinks[9, 10]
    assert at.kinks.sum() == 1
    assert at.influence[9, 10] == 0
    assert not at.smooth[9, 10]


def test_what_is_behind_an_opaque_layer_is_of_no_influence():
    scene = make_scene(count=400, size=1.5, opacity=(1.0, 1.0), settings=RasterSettings(transmittance_minimum=0.0))
    assert (find_discontinuities(scene, 1e-3).influence == 0).double().mean() > 0.5


def test_a_picture_full_of_thresholds_is_no_comparison():
    scene = sample_scene()
    with pytest.raises(AssertionError, match="is smooth"):
        discontinuities_of(scene, replace(FLOAT32, margin=0.9))
