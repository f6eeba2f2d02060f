"""Gradients against finite differences in float64, and, where there are steps, against autograd on the reference."""

from __future__ import annotations

import pytest
import torch

from opencl.contract import RasterSettings
from opencl.rasterizer import rasterize
from tests.opencl.scenes import FAINT, gradients, make_scene, one_gaussian

pytestmark = pytest.mark.usefixtures("both_schedules")

NAMES = ("means", "quats", "scales", "opacities", "features", "background")


def _projected(scene, *leaves):
    """Three fixed random sums of the picture: as informative as the whole picture, and cheap to differentiate."""
    *gaussians, background = leaves
    output = rasterize(*gaussians, *scene.camera, background, scene.settings)
    values = torch.cat([output.features.flatten(), output.alphas.flatten()])
    random = torch.Generator().manual_seed(5)
    return torch.randn(3, len(values), generator=random, dtype=values.dtype) @ values


# Opacities stay below the clamp, and so few Gaussians never end a pixel: the picture is smooth but for faint edges.
@pytest.mark.parametrize(
    ("feature_dim", "size"),
    [
        *((1, (8, 8)), (3, (24, 17)), (17, (9, 8))),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((8, (12, 24)), (16, (16, 16)), (32, (8, 12)))),
    ],
)
def test_gradcheck(feature_dim, size):
    scene = make_scene(
        *(4, feature_dim, *size),
        seed=feature_dim,
        size=0.5,
        opacity=(0.1, 0.6),
        settings=FAINT,
    )
    leaves = [tensor.requires_grad_() for tensor in (*scene.gaussians, scene.background)]
    assert torch.autograd.gradcheck(lambda *values: _projected(scene, *values), leaves, eps=1e-6, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("wanted", NAMES)
def test_each_input_alone_gets_the_gradient_it_gets_among_all(wanted):
    scene = make_scene(count=20)
    tensors = dict(zip(NAMES, (*scene.gaussians, scene.background), strict=True))
    everything = {name: tensor.clone().requires_grad_() for name, tensor in tensors.items()}
    _projected(scene, *everything.values()).sum().backward()
    alone = {name: tensor.clone().requires_grad_(name == wanted) for name, tensor in tensors.items()}
    _projected(scene, *alone.values()).sum().backward()
    assert torch.equal(alone[wanted].grad, everything[wanted].grad)
    assert all(tensor.grad is None for name, tensor in alone.items() if name != wanted)


@pytest.mark.parametrize("feature_dim", [1, 3, 16, 17, 32, 40, 70])
def test_float64_gradients_are_the_reference_s(feature_dim):
    scene = make_scene(count=60, feature_dim=feature_dim, size=0.4)
    _compare_with_reference(scene, 1e-10)


def test_gradients_where_alpha_is_clamped_and_pixels_end():
    scene = make_scene(count=300, size=0.8, opacity=(0.9, 1.0))
    assert scene.draw().alphas.max() > 0.999
    _compare_with_reference(scene, 1e-8)


def test_no_gradient_through_a_clamped_alpha():
    scene = one_gaussian(scales=(0.5, 0.5, 0.5), opacity=1.0)
    assert (scene.draw().alphas == 0.99).sum() >= 4
    _compare_with_reference(scene, 1e-12)


@pytest.mark.parametrize("clamp_about", ["optical_axis", "principal_point"])
def test_gradients_where_the_linearisation_is_clamped(clamp_about):
    settings = RasterSettings(
        field_of_view_margin=0.3 if clamp_about == "optical_axis" else 1.0, clamp_about=clamp_about
    )
    _compare_with_reference(make_scene(count=60, size=0.4, settings=settings), 1e-10)


def test_float32_gradients_are_the_reference_s_in_the_mean():
    scene = make_scene(count=200, feature_dim=16, width=64, height=48, size=0.2)
    scene = type(scene)(**{**vars(scene), "settings": FAINT})
    expected = _gradients_of(scene, "draw_reference")
    found = _gradients_of(scene.to(torch.float32), "draw")
    for name, one, other in zip((*NAMES, "means2d"), found, expected, strict=True):
        error = (one.double() - other).norm() / other.norm()
        assert error < 1e-4, f"{name}: {error}"


def _gradients_of(scene, method):
    leaves = tuple(tensor.clone().requires_grad_() for tensor in (*scene.gaussians, scene.background))
    names = ("means", "quats", "scales", "opacities", "features")
    changed = type(scene)(**{**vars(scene), **dict(zip(names, leaves, strict=False)), "background": leaves[-1]})
    return gradients(getattr(changed, method)(), leaves)


def _compare_with_reference(scene, tolerance):
    for name, found, expected in zip(
        (*NAMES, "means2d"), _gradients_of(scene, "draw"), _gradients_of(scene, "draw_reference"), strict=True
    ):
        error = (found - expected).abs().max() / expected.abs().max().clamp_min(1e-6)
        assert error < tolerance, f"{name}: {error}"


def test_means2d_keeps_its_gradient_after_backward():
    scene = make_scene(count=30)
    leaves = [tensor.requires_grad_() for tensor in scene.gaussians]
    output = rasterize(*leaves, *scene.camera)
    output.features.sum().backward()
    assert output.means2d.grad is not None
    assert output.means2d.grad.shape == (30, 2)
    assert (output.means2d.grad[output.radii == 0] == 0).all()
    assert (output.means2d.grad[output.radii > 0] != 0).any()


def test_moving_a_gaussian_on_the_screen_is_moving_it_in_the_world():
    scene = one_gaussian()
    scene.means.requires_grad_()
    output = scene.draw()
    output.features[:, 11:].sum().backward()
    # x = fx X / Z, and a small X does not change the projected size of a Gaussian on the axis.
    assert scene.means.grad[0, 0].item() == pytest.approx(20 / 2 * output.means2d.grad[0, 0].item(), rel=1e-6)


def test_no_grad_gives_the_same_picture_and_keeps_nothing():
    scene = make_scene(dtype=torch.float32)
    leaves = [tensor.requires_grad_() for tensor in scene.gaussians]
    with_graph = rasterize(*leaves, *scene.camera)
    with torch.no_grad():
        without = rasterize(*leaves, *scene.camera)
    assert torch.equal(with_graph.features, without.features)
    assert without.features.grad_fn is None
    assert without.means2d.grad_fn is None
