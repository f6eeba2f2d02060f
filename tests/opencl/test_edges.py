"""Gaussians at the edges of what can be drawn: none, behind, on the near plane, huge, thin, faint, not finite."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from opencl.contract import RasterSettings
from opencl.rasterizer import rasterize
from tests.opencl.scenes import gradients, make_scene, near_a_threshold, one_gaussian

pytestmark = pytest.mark.usefixtures("both_schedules")


def test_no_gaussian_is_the_background():
    scene = make_scene(count=0, dtype=torch.float32)
    background = scene.background.requires_grad_()
    output = rasterize(*scene.gaussians, *scene.camera, background)
    assert torch.equal(output.features, background.detach().expand_as(output.features))
    assert output.alphas.abs().max() == 0
    assert output.radii.shape == (0,)
    assert output.means2d.shape == (0, 2)
    output.features.sum().backward()
    assert background.grad.tolist() == [scene.width * scene.height] * 3


def test_no_gaussian_in_view_is_the_background():
    scene = make_scene(count=30)
    behind = scene.only(torch.arange(30))
    behind.means.copy_(-scene.means)
    leaves = tuple(tensor.requires_grad_() for tensor in behind.gaussians)
    output = behind.draw()
    assert torch.equal(output.features, behind.background.expand_as(output.features))
    assert (output.radii == 0).all()
    assert all((gradient == 0).all() for gradient in gradients(output, leaves))


@pytest.mark.parametrize(
    ("depth", "visible"), [(-2.0, False), (0.0, False), (0.2, False), (0.2000001, True), (0.21, True)]
)
def test_the_near_plane(depth, visible):
    scene = one_gaussian(centre=(0.0, 0.0, depth), scales=(0.02, 0.02, 0.3))
    output = scene.draw()
    assert (output.radii.item() > 0) == visible
    assert output.features.isfinite().all()
    torch.testing.assert_close(output.features, scene.draw_reference().features, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [1.0, 30.0, 1e4, 1e12, 1e30])
def test_larger_than_the_picture(dtype, size):
    scene = one_gaussian(scales=(size, size, size), dtype=dtype, width=50, height=40)
    scene.scales.requires_grad_()
    output = scene.draw()
    assert output.features.isfinite().all()
    if output.radii.item() > 1000:
        assert output.alphas.min() > 0.3
    output.features.sum().backward()
    assert scene.scales.grad.isfinite().all()


def test_reach_within_a_strip_of_tiles():
    # Long and slanted: in each row of tiles, it must be listed for exactly the tiles that it crosses.
    scene = one_gaussian(scales=(3.0, 0.02, 0.02), width=150, height=130, opacity=1.0)
    for turn in (0.0, 0.3, 0.8, 1.5, 2.2, 3.0):
        scene.quats.copy_(torch.tensor([[1.0, 0.0, 0.0, turn]]))
        torch.testing.assert_close(scene.draw().features, scene.draw_reference().features, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("length", [1.0, 100.0])
def test_needles_in_float32(length):
    scene = make_scene(count=40, width=64, height=64)
    scene.scales.copy_(torch.tensor([length, 1e-6, 1e-6]))
    single = scene.to(torch.float32)
    drawn, expected = single.draw(), single.to(torch.float64).draw_reference()
    assert drawn.features.isfinite().all()
    sound = ~near_a_threshold(single, margin=0.02)
    assert (drawn.features.double() - expected.features)[sound].abs().max() < 1e-3


@pytest.mark.parametrize("opacity", [0.0, 1 / 255 - 1e-9, 1 / 255, 1 / 255 + 1e-9, 1.0, 1.5])
def test_opacity_at_thresholds(opacity):
    scene = one_gaussian(centre=(0.05, 0.05, 2.0), opacity=opacity)  # on a pixel's centre
    drawn, expected = scene.draw(), scene.draw_reference()
    torch.testing.assert_close(drawn.features, expected.features, rtol=1e-12, atol=1e-15)
    assert torch.equal(drawn.radii, expected.radii)
    assert drawn.alphas.max() <= 0.99 + 1e-12
    assert (drawn.alphas.max() > 0) == (opacity >= 1 / 255)


@pytest.mark.parametrize("quat", [(1e-30, 0, 0, 0), (1e30, 1e30, 0, 0), (3e-20, 1e-20, -2e-20, 0)])
def test_quaternions_of_any_length(quat):
    scene = make_scene(count=1, size=0.4, dtype=torch.float32)
    unit = torch.nn.functional.normalize(torch.tensor([quat], dtype=torch.float64)).float()
    pictures = []
    for value in (torch.tensor([quat], dtype=torch.float32), unit):
        scene.quats.copy_(value)
        pictures.append(scene.draw().features)
    torch.testing.assert_close(pictures[0], pictures[1], rtol=1e-5, atol=1e-6)


def test_a_crowd_in_one_tile():
    crowd = make_scene(
        count=20_000, width=16, height=16, feature_dim=3, size=0.02, opacity=(0.004, 0.01), dtype=torch.float32
    )
    crowd.means[:, :2] *= 0.05
    leaves = tuple(tensor.requires_grad_() for tensor in crowd.gaussians)
    output = crowd.draw()
    assert output.features.isfinite().all()
    assert all(gradient.isfinite().all() for gradient in gradients(output, leaves))


@pytest.mark.slow
def test_a_million_in_one_tile():
    count = 1_000_000
    crowd = make_scene(
        count=count, width=16, height=16, feature_dim=3, size=0.02, opacity=(0.004, 0.01), dtype=torch.float32
    )
    leaves = tuple(tensor.requires_grad_() for tensor in crowd.gaussians)
    output = crowd.draw()
    assert all(gradient.isfinite().all() for gradient in gradients(output, leaves))


def test_more_pairs_than_can_be_counted_is_an_error():
    count, width, height = 4000, 16_384, 16_384  # a million tiles each
    scene = one_gaussian(scales=(1e6, 1e6, 1e6), width=width, height=height, dtype=torch.float32)
    many = scene.only(torch.zeros(count, dtype=torch.long))
    with pytest.raises(RuntimeError, match="pairs of a Gaussian and a tile"):
        many.draw()


POISON = st.sampled_from([float("nan"), float("inf"), -float("inf")])


@settings(max_examples=40, deadline=None)
@given(value=POISON, field=st.integers(0, 4), index=st.integers(0, 29), column=st.integers(0, 2))
def test_a_value_that_is_not_finite_hides_its_gaussian_and_no_other(value, field, index, column):
    scene = make_scene(count=30, dtype=torch.float32)
    tensor = scene.gaussians[field]
    if tensor.ndim == 1:
        tensor[index] = value
    else:
        tensor[index, column] = value
    others = torch.arange(30) != index
    poisoned = tuple(tensor.requires_grad_() for tensor in scene.gaussians)
    output = scene.draw()
    clean = make_scene(count=30, dtype=torch.float32).only(others)
    clean_leaves = tuple(tensor.requires_grad_() for tensor in clean.gaussians)
    expected = clean.draw()
    assert torch.equal(output.features, expected.features)
    assert output.radii[index] == 0
    for found, wanted in zip(gradients(output, poisoned), gradients(expected, clean_leaves), strict=True):
        assert torch.equal(found[others], wanted)
        assert (found[index] == 0).all()


ODD = st.sampled_from([0.0, -0.0, 1e-45, 1e-38, -1e-20, 0.2, 1 / 255, 0.99, 1.0, 1e10, -1e10, 1e19, 3e38, -3e38])


@settings(max_examples=60, deadline=None)
@given(data=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 19), st.integers(0, 2), ODD), max_size=12))
def test_odd_values_give_a_finite_picture(data):
    scene = make_scene(count=20, dtype=torch.float32)
    for field, index, column, value in data:
        tensor = scene.gaussians[field]
        if tensor.ndim == 1:
            tensor[index] = value
        else:
            tensor[index, column] = value
    output = scene.draw()
    assert output.features.isfinite().all()
    assert ((output.alphas >= 0) & (output.alphas <= 1)).all()


def test_gsplat_s_near_plane():
    near = one_gaussian(centre=(0.0, 0.0, 0.05), scales=(0.01, 0.01, 0.01), settings=RasterSettings(near=0.01))
    assert near.draw().radii.item() > 0
