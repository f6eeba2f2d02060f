"""Options of the rasterizer: antialiasing, depths, absolute gradients, pixel counts, and batches of cameras."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

import opencl.blending
from opencl.rasterizer import rasterize
from opencl.reference import rasterize_reference
from tests.opencl.scenes import FAINT, gradients, make_scene

pytestmark = pytest.mark.usefixtures("both_schedules")

ANTIALIASED = replace(FAINT, antialiased=True)


@pytest.mark.parametrize("size", [0.02, 0.4])
def test_antialiasing_is_the_reference_s(size):
    scene = make_scene(count=80, size=size, settings=ANTIALIASED)
    drawn, expected = scene.draw(), scene.draw_reference()
    torch.testing.assert_close(drawn.features, expected.features, rtol=1e-9, atol=1e-11)
    assert torch.equal(drawn.radii, expected.radii)


def test_antialiasing_keeps_the_light_of_a_gaussian_that_moves_away():
    def light(distance, settings):
        scene = make_scene(count=1, size=0.02, opacity=(0.3, 0.3), settings=settings, width=40, height=40)
        in_camera = torch.tensor([[0.0, 0.0, distance]], dtype=torch.float64)
        pose = scene.world_to_camera
        scene.means.copy_((in_camera - pose[:3, 3]) @ pose[:3, :3])
        return scene.draw().alphas.sum().item() * distance**2

    assert light(20, ANTIALIASED) == pytest.approx(light(5, ANTIALIASED), rel=0.05)
    assert light(20, FAINT) > 2 * light(5, FAINT)


def test_gradients_of_antialiased_gaussians():
    scene = make_scene(count=60, size=0.05, settings=ANTIALIASED)
    found, expected = (_gradients(scene, method) for method in ("draw", "draw_reference"))
    for one, other in zip(found, expected, strict=True):
        assert (one - other).abs().max() <= 1e-9 * other.abs().max()


def test_gradcheck_of_antialiased_gaussians():
    scene = make_scene(4, 3, 12, 9, seed=3, size=0.1, opacity=(0.1, 0.6), settings=ANTIALIASED)
    leaves = [tensor.requires_grad_() for tensor in scene.gaussians]

    def total(*gaussians):
        output = rasterize(*gaussians, *scene.camera, scene.background, ANTIALIASED)
        weights = torch.arange(output.features.numel(), dtype=torch.float64).reshape(output.features.shape)
        return (output.features * (1 + weights).sin()).sum()

    assert torch.autograd.gradcheck(total, leaves, eps=1e-6, atol=1e-6, rtol=1e-5)


def test_depths_are_a_blended_feature():
    scene = make_scene(count=60, size=0.4)
    means, quats, scales, opacities, features = leaves = tuple(tensor.requires_grad_() for tensor in scene.gaussians)
    output = rasterize(*leaves, *scene.camera, scene.background, depth=True)
    pose = scene.world_to_camera
    depths = (means @ pose[2, :3] + pose[2, 3])[:, None]
    background = torch.cat([scene.background, torch.zeros(1, dtype=torch.float64)])
    expected = rasterize_reference(
        means, quats, scales, opacities, torch.cat([features, depths], dim=1), *scene.camera, background
    )
    torch.testing.assert_close(output.depths, expected.features[..., -1], rtol=1e-11, atol=1e-12)
    torch.testing.assert_close(output.features, scene.draw().features, rtol=1e-13, atol=1e-14)
    assert output.features.is_contiguous()
    found = torch.autograd.grad(output.depths.square().sum(), leaves)
    wanted = torch.autograd.grad(expected.features[..., -1].square().sum(), leaves, allow_unused=True)
    for one, other in zip(found, wanted, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-8, atol=1e-8)


def test_absolute_gradients_are_summed_pixel_by_pixel():
    scene = make_scene(count=12, size=0.3, width=20, height=18)
    leaves = tuple(tensor.requires_grad_() for tensor in scene.gaussians)
    output = rasterize(*leaves, *scene.camera, scene.background, absolute_gradients=True)
    weights = torch.randn(output.features.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    (output.features * weights).sum().backward(retain_graph=True)
    signed = output.means2d.grad.clone()
    expected = torch.zeros_like(signed)
    for row in range(scene.height):
        for column in range(scene.width):
            pixel = (output.features[row, column] * weights[row, column]).sum()
            expected += torch.autograd.grad(pixel, output.means2d, retain_graph=True)[0].abs()
    torch.testing.assert_close(output.absolute_gradients.grad, expected, rtol=1e-9, atol=1e-12)
    assert (expected > signed.abs() + 1e-6).any()


def test_absolute_gradients_of_many_channels_are_those_of_one_pass():
    scene = make_scene(count=4, feature_dim=opencl.blending.LARGEST_FEATURE_DIM)
    with pytest.raises(ValueError, match="absolute_gradients: found 65 features"):
        rasterize(*scene.gaussians, *scene.camera, depth=True, absolute_gradients=True)


def test_pixels_of_each_gaussian_are_counted():
    scene = make_scene(count=40, size=0.4, opacity=(0.5, 1.0), width=45, height=33)
    scene.means[:5, 2] = -9.0  # behind the camera
    output = rasterize(*scene.gaussians, *scene.camera, count_pixels=True)
    # A channel where one Gaussian's feature is 1 and all others' are 0 shows where that Gaussian is drawn.
    alone = scene.only(torch.arange(40))
    shown = rasterize(*alone.gaussians[:4], torch.eye(40, dtype=torch.float64), *scene.camera).features
    assert output.pixel_counts.tolist() == (shown > 0).sum(dim=(0, 1)).tolist()
    assert output.pixel_counts.dtype == torch.int32
    assert (output.pixel_counts == 0).any()
    assert (output.pixel_counts > 100).any()


def test_radii_and_counts_may_be_changed_before_the_gradients_are_computed():
    """No gradient depends on them: density control may keep its maximum in them."""
    scene = make_scene(count=20)
    leaves = tuple(tensor.clone().requires_grad_() for tensor in scene.gaussians)
    found = []
    for changes in (False, True):
        output = rasterize(*leaves, *scene.camera, count_pixels=True)
        if changes:
            output.radii.clamp_(max=1)
            output.pixel_counts.zero_()
        found.append(torch.autograd.grad(output.features.square().sum(), leaves))
    assert all(torch.equal(one, other) for one, other in zip(*found, strict=True))


def test_a_batch_of_cameras_is_each_camera_by_itself():
    scene = make_scene(count=50, dtype=torch.float32)
    poses = torch.stack([scene.world_to_camera, scene.world_to_camera.clone(), scene.world_to_camera.clone()])
    poses[1, :3, 3] += torch.tensor([0.3, 0.0, 0.5])
    poses[2, :3, 3] -= torch.tensor([0.0, 0.4, 0.2])
    calibrations = torch.stack(
        [scene.intrinsics, scene.intrinsics * torch.tensor([1.1, 1.2, 1.0])[:, None], scene.intrinsics]
    )
    backgrounds = torch.rand(3, 3, generator=torch.Generator().manual_seed(2))
    wishes = {"depth": True, "absolute_gradients": True, "count_pixels": True}
    size = (scene.width, scene.height)

    leaves = tuple(tensor.clone().requires_grad_() for tensor in scene.gaussians)
    together = rasterize(*leaves, poses, calibrations, *size, backgrounds, **wishes)
    weights = torch.randn(together.features.shape, generator=torch.Generator().manual_seed(1))
    ((together.features * weights).sum() + together.depths.sum()).backward()

    summed = [torch.zeros_like(tensor) for tensor in scene.gaussians]
    for index in range(3):
        own = tuple(tensor.clone().requires_grad_() for tensor in scene.gaussians)
        single = rasterize(*own, poses[index], calibrations[index], *size, backgrounds[index], **wishes)
        ((single.features * weights[index]).sum() + single.depths.sum()).backward()
        for name in ("features", "alphas", "radii", "means2d", "depths", "pixel_counts"):
            assert torch.equal(getattr(together, name)[index], getattr(single, name)), name
        assert torch.equal(together.means2d.grad[index], single.means2d.grad)
        assert torch.equal(together.absolute_gradients.grad[index], single.absolute_gradients.grad)
        summed = [total + tensor.grad for total, tensor in zip(summed, own, strict=True)]
    for found, expected in zip(leaves, summed, strict=True):
        torch.testing.assert_close(found.grad, expected, rtol=1e-5, atol=1e-6)


def test_a_batch_shares_one_background_and_may_hold_one_camera():
    scene = make_scene(count=20)
    batch = rasterize(
        *scene.gaussians,
        scene.world_to_camera[None],
        scene.intrinsics[None],
        scene.width,
        scene.height,
        scene.background,
    )
    assert torch.equal(batch.features, scene.draw().features[None])
    assert batch.means2d.shape == (1, 20, 2)
    assert batch.depths is None


@pytest.mark.usefixtures("any_arrays")
def test_a_batch_of_no_camera_or_of_unlike_numbers_is_named():
    scene = make_scene(count=5)
    view = (scene.world_to_camera.expand(2, 4, 4), scene.intrinsics.expand(3, 3, 3), scene.width, scene.height)
    with pytest.raises(ValueError, match=r"intrinsics: found shape \(3, 3, 3\), expected \(2, 3, 3\)"):
        rasterize(*scene.gaussians, *view)
    with pytest.raises(ValueError, match="world_to_camera: found shape"):
        rasterize(*scene.gaussians, scene.world_to_camera[None][:0], scene.intrinsics[None][:0], 8, 8)


def test_without_gradients_nothing_is_kept_for_them():
    scene = make_scene(count=30)
    leaves = tuple(tensor.requires_grad_() for tensor in scene.gaussians)
    with torch.no_grad():
        output = rasterize(*leaves, *scene.camera, depth=True, absolute_gradients=True)
    assert all(tensor.grad_fn is None for tensor in (output.features, output.alphas, output.means2d, output.depths))
    assert not output.absolute_gradients.requires_grad
    assert torch.equal(output.features, rasterize(*leaves, *scene.camera).features)


def _gradients(scene, method):
    leaves = tuple(tensor.clone().requires_grad_() for tensor in scene.gaussians)
    names = ("means", "quats", "scales", "opacities", "features")
    changed = replace(scene, **dict(zip(names, leaves, strict=True)))
    return gradients(getattr(changed, method)(), leaves)
