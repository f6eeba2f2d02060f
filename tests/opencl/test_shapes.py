"""Pictures and gradients against the reference, for many sizes and numbers of Gaussians and channels."""

from __future__ import annotations

import math

import pytest
import torch

from tests.opencl.runtimes import SCHEDULES, backend_of, draw_on, draw_with_gradients
from tests.opencl.scenes import FAINT, gradients, make_scene, near_a_threshold, one_gaussian

NAMES = ("means", "quats", "scales", "opacities", "features", "background", "means2d")
SIZES = [(1, 1), (1, 40), (40, 1), (17, 16), (16, 17), (15, 33)]
FEATURE_DIMS = [1, 3, 8, 16, 17, 32, 64, 128]


@pytest.fixture(params=SCHEDULES)
def backend(request):
    return backend_of(request.param)


def compare(backend, scene, tolerance=1e-10, picture_tolerance=1e-12):
    """Compare picture and gradients with the reference's, in float64; each gradient relative to its largest value."""
    output, found = draw_with_gradients(backend, scene)
    leaves = tuple(tensor.clone().requires_grad_() for tensor in (*scene.gaussians, scene.background))
    changed = dict(zip(NAMES[:6], leaves, strict=True))
    reference = type(scene)(**{**vars(scene), **changed}).draw_reference()
    torch.testing.assert_close(output.features, reference.features, rtol=1e-11, atol=picture_tolerance)
    torch.testing.assert_close(output.alphas, reference.alphas, rtol=1e-11, atol=picture_tolerance)
    torch.testing.assert_close(output.means2d, reference.means2d, rtol=1e-12, atol=1e-12)
    assert torch.equal(output.radii, reference.radii)
    assert output.features.shape == (scene.height, scene.width, scene.features.shape[1])
    assert output.features.is_contiguous()
    for name, one, other in zip(NAMES, found, gradients(reference, leaves), strict=True):
        error = (one - other).abs().max() / other.abs().max().clamp_min(1e-6)
        assert error < tolerance, f"{name}: {error}"
    return output


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("feature_dim", [3, 17])
def test_sides_that_are_no_multiple_of_a_tile(backend, size, feature_dim):
    output = compare(backend, make_scene(40, feature_dim, *size, size=0.4))
    assert output.alphas.max() > 0.1


@pytest.mark.parametrize("feature_dim", FEATURE_DIMS)
def test_any_number_of_channels(backend, feature_dim):
    compare(backend, make_scene(30, feature_dim, 19, 18, size=0.4))


@pytest.mark.parametrize("feature_dim", FEATURE_DIMS)
def test_channels_do_not_depend_on_each_other(backend, feature_dim):
    scene = make_scene(60, feature_dim, 35, 20, dtype=torch.float32)
    only_last = type(scene)(
        **{**vars(scene), "features": scene.features[:, -1:].contiguous(), "background": scene.background[-1:]}
    )
    everything, last = draw_on(backend, scene), draw_on(backend, only_last)
    torch.testing.assert_close(everything.features[..., -1:], last.features, rtol=1e-6, atol=1e-6)
    assert torch.equal(everything.alphas, last.alphas)


@pytest.mark.parametrize("count", [0, 1, 2, 127, 128, 129, 300])
def test_any_number_of_gaussians(backend, count):
    scene = make_scene(count, 3, 21, 18, size=0.3)
    if count == 0:
        output, found = draw_with_gradients(backend, scene)
        assert torch.equal(output.features, scene.background.expand_as(output.features))
        assert [tuple(gradient.shape) for gradient in found[:5]] == [(0, 3), (0, 4), (0, 3), (0,), (0, 3)]
    else:
        compare(backend, scene, 1e-9)


@pytest.mark.parametrize("count", [0, 1])
@pytest.mark.parametrize("feature_dim", [1, 128])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_one_pixel(backend, count, feature_dim, dtype):
    output, found = draw_with_gradients(backend, make_scene(count, feature_dim, 1, 1, size=1.0, dtype=dtype))
    assert output.features.shape == (1, 1, feature_dim)
    assert all(gradient.isfinite().all() for gradient in found)


def test_behind_and_across_the_near_plane_among_others(backend):
    scene = make_scene(60, 3, 33, 31, size=0.3)
    depths = torch.linspace(-1.0, 1.4, 60, dtype=torch.float64)  # on both sides of the near plane, 0.2
    in_camera = torch.cat([0.3 * scene.means[:, :2], depths[:, None]], dim=1)
    rotation, translation = scene.world_to_camera[:3, :3], scene.world_to_camera[:3, 3]
    scene.means.copy_((in_camera - translation) @ rotation)
    output = compare(backend, scene)
    assert (output.radii[depths < 0.19] == 0).all()
    assert (output.radii[depths > 0.5] > 0).any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_first_depth_behind_the_near_plane(backend, dtype):
    near = torch.tensor(0.2, dtype=dtype)
    after = torch.nextafter(near, torch.tensor(1.0, dtype=dtype)).item()
    before = torch.nextafter(near, torch.tensor(0.0, dtype=dtype)).item()
    for depth, visible in ((before, False), (near.item(), False), (after, True)):
        output = draw_on(backend, one_gaussian(centre=(0.0, 0.0, depth), scales=(0.02, 0.02, 0.02), dtype=dtype))
        assert (output.radii.item() > 0) == visible, depth


def test_larger_than_the_picture_among_others(backend):
    scene = make_scene(40, 3, 50, 40, size=0.3)
    scene.scales[::7] *= 100
    output = compare(backend, scene)
    assert output.radii.max() > 200


def test_far_outside(backend):
    scene = make_scene(50, 3, 33, 31, size=0.2)
    others = torch.arange(50) % 2 == 1
    for factor in (20.0, 1e6, 1e15):
        far = scene.only(torch.arange(50))
        far.means[~others, 0] = factor
        output, found = draw_with_gradients(backend, far)
        alone = draw_on(backend, scene.only(others))
        assert torch.equal(output.features, alone.features)
        assert (output.radii[~others] == 0).all()
        assert all((gradient[~others] == 0).all() for gradient in found[:5])


@pytest.mark.parametrize("threshold", [1 / 255, 0.99])
def test_float32_opacities_on_both_sides_of_a_threshold(backend, threshold):
    exact = torch.tensor(threshold, dtype=torch.float32)
    zero, one = torch.zeros(()), torch.ones(())
    opacities = [torch.nextafter(exact, zero).item(), exact.item(), torch.nextafter(exact, one).item()]
    drawn = []
    for opacity in opacities:  # at the centre of pixel (9, 10), where alpha is the opacity itself
        output, found = draw_with_gradients(
            backend, one_gaussian((0.05, 0.05, 2.0), (0.5, 0.5, 0.0), opacity=opacity, dtype=torch.float32)
        )
        assert all(gradient.isfinite().all() for gradient in found)
        drawn.append((output.alphas[9, 10].item(), output.radii.item(), found[3][0].item()))
    alphas, radii, gradients_of_opacity = zip(*drawn, strict=True)
    if threshold == 0.99:
        assert alphas == pytest.approx([0.99] * 3, rel=3e-7)
        assert gradients_of_opacity[0] != pytest.approx(gradients_of_opacity[2], rel=1e-3)  # [2] lacks the centre's
    else:
        assert alphas[0] == 0
        assert radii[0] == 0
        assert gradients_of_opacity[0] == 0
        assert alphas[2] == pytest.approx(threshold, rel=1e-6)
        assert radii[2] > 0


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 4, 1.4])
@pytest.mark.parametrize(("length", "picture_tolerance"), [(0.5, 1e-12), (10.0, 1e-10)])
def test_needles(backend, angle, length, picture_tolerance):
    scene = make_scene(12, 3, 40, 37)
    scene.scales.copy_(torch.tensor([length, 1e-9, 1e-9]))
    scene.quats.copy_(torch.tensor([math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)]))
    # The reference inverts an almost singular covariance: it is the less exact of the two.
    compare(backend, scene, 1e-6, picture_tolerance)


def test_flat_gaussians_seen_from_their_edge(backend):
    scene = make_scene(30, 3, 33, 31)
    scene.scales[:, 2] = 0
    scene.quats[:15] = torch.tensor([math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0], dtype=torch.float64)
    compare(backend, scene)


def test_points(backend):
    scene = make_scene(40, 3, 33, 31)
    scene.scales.zero_()
    output, found = draw_with_gradients(backend, scene)
    torch.testing.assert_close(output.features, scene.draw_reference().features, rtol=1e-11, atol=1e-12)
    assert all(gradient.isfinite().all() for gradient in found)


def test_pictures_at_the_clamp_in_float32(backend):
    scene = make_scene(40, 3, 33, 31, size=0.4, opacity=(0.98, 1.0), dtype=torch.float32)
    sound = ~near_a_threshold(scene)
    difference = draw_on(backend, scene).features.double() - scene.to(torch.float64).draw_reference().features
    assert difference[sound].abs().max() < 1e-5


def test_a_crowd_in_one_tile_all_of_them_seen(backend):
    count = 300_000 if backend.schedule == "cpu" else 70_000  # on a CPU, the GPU schedule takes half a minute
    crowd = make_scene(count, 1, 16, 16, size=0.3, opacity=(1e-6, 2e-6), dtype=torch.float32, settings=FAINT)
    crowd.means.mul_(0.05)  # all around the camera's axis, at different depths
    crowd.means[:, 2] += torch.linspace(2, 3, count)
    output, found = draw_with_gradients(backend, crowd)
    assert (output.radii > 0).all()
    assert 0.05 < output.alphas.max() < 0.9
    exact = draw_on(backend, crowd.to(torch.float64))
    assert (output.alphas - exact.alphas).abs().max() < count * 2**-25  # half a unit in the last place each
    assert all(gradient.isfinite().all() for gradient in found)
    assert (found[4] != 0).all()
