"""Gaussians multiply where gradients are large, and go where they are transparent or too large."""

from __future__ import annotations

import math

import pytest
import torch

from stages.hiding.rendering import Rendering
from stages.scene.gaussians import Gaussians, gaussians_at
from stages.training.density_control import DensityControl, DensitySettings
from stages.training.optimizer import GaussianOptimizer
from stages.training.schedules import decayed, density_schedule

RATES = dict.fromkeys(("means", "quats", "log_scales", "logit_opacities"), 1e-3)
EXTENT = 10.0


def optimizer_with(scales: list[float], opacity: float = 0.5) -> GaussianOptimizer:
    points = torch.arange(3 * len(scales), dtype=torch.float32).reshape(-1, 3).numpy()
    gaussians = gaussians_at(points, {})
    gaussians.parameters["log_scales"] = torch.tensor(scales).log()[:, None].repeat(1, 3)
    gaussians.parameters["logit_opacities"] = torch.full((len(scales),), math.log(opacity / (1 - opacity)))
    return GaussianOptimizer(gaussians, RATES)


def seen_with_gradients(gradients: list[float], radii: list[int] | None = None) -> Rendering:
    means2d = torch.zeros(len(gradients), 2, requires_grad=True)
    means2d.grad = torch.tensor([[value, 0.0] for value in gradients])
    return Rendering({}, torch.zeros(1, 1, 1), torch.zeros(1, 1), torch.tensor(radii or [3] * len(gradients)), means2d)


def refined(optimizer: GaussianOptimizer, rendering: Rendering, **settings: float) -> Gaussians:
    control = DensityControl(DensitySettings(**settings), EXTENT, len(optimizer.gaussians))
    control.observe(rendering, width=2, height=2)
    control.refine(optimizer, prune_large=False, generator=torch.Generator().manual_seed(0))
    return optimizer.gaussians


def test_small_ones_are_cloned_in_place() -> None:
    """Small are those of at most a hundredth of the extent."""
    gaussians = refined(optimizer_with([0.09, 0.01]), seen_with_gradients([1e-3, 0]))
    assert len(gaussians) == 3
    assert torch.equal(gaussians.means[2], gaussians.means[0])


def test_large_ones_are_split_into_two_smaller_ones() -> None:
    gaussians = refined(optimizer_with([0.5, 0.01]), seen_with_gradients([1e-3, 0]))
    assert len(gaussians) == 3
    torch.testing.assert_close(gaussians.scales[1:], torch.full((2, 3), 0.5 / 1.6))


def test_transparent_ones_go() -> None:
    assert len(refined(optimizer_with([0.01], opacity=0.004), seen_with_gradients([0]))) == 0
    assert len(refined(optimizer_with([0.01], opacity=0.006), seen_with_gradients([0]))) == 1


def test_what_is_large_in_the_world_goes_and_on_the_screen_stays() -> None:
    """Only once an opacity reset has passed. 3DGS also means to prune by size on the screen, but never does."""
    optimizer = optimizer_with([0.01, 1.1, 0.5])
    control = DensityControl(DensitySettings(), EXTENT, 3)
    control.observe(seen_with_gradients([0, 0, 0], radii=[500, 3, 3]), 2, 2)
    control.refine(optimizer, prune_large=True, generator=torch.Generator().manual_seed(0))
    expected = torch.tensor([0.01, 0.5])[:, None].expand(2, 3)
    torch.testing.assert_close(optimizer.gaussians.scales.detach(), expected)


def test_gradients_count_up_and_across_in_device_coordinates() -> None:
    seen = seen_with_gradients([0.0, 0.0, 0.0])
    seen.means2d.grad = torch.tensor([[3.0, 0.0], [0.0, 3.0], [0.3, 1.0]])
    control = DensityControl(DensitySettings(), EXTENT, 3)
    control.observe(seen, width=20, height=8)
    assert control.gradient_sums.tolist() == [30.0, 12.0, 5.0]


def test_children_lie_along_their_parents_axes() -> None:
    """A thin Gaussian along x, turned by 45 degrees about z, from x towards y."""
    optimizer = optimizer_with([1.0])
    gaussians = optimizer.gaussians
    with torch.no_grad():
        gaussians["log_scales"].copy_(torch.tensor([[1.0, 1e-6, 1e-6]]).log())
        gaussians["quats"].copy_(torch.tensor([[math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8)]]))
    parent = gaussians.means.detach().clone()
    away = refined(optimizer, seen_with_gradients([1e-3])).means.detach() - parent
    assert len(away) == 2
    torch.testing.assert_close(away[:, 0], away[:, 1], atol=1e-4, rtol=0)
    assert away[:, 2].abs().max() < 1e-4
    assert away[:, 0].abs().min() > 1e-2


def test_never_more_than_the_maximum_and_the_strongest_first() -> None:
    optimizer = optimizer_with([0.01, 0.01, 0.01])
    gaussians = refined(optimizer, seen_with_gradients([2e-3, 5e-3, 3e-3]), maximum_gaussians=4)
    assert len(gaussians) == 4
    assert torch.equal(gaussians.means[3], gaussians.means[1])


@pytest.mark.parametrize(("maximum", "limited"), [(4, True), (5, False)])
def test_it_is_known_whether_the_maximum_kept_any_from_growing(maximum: int, limited: bool) -> None:
    optimizer = optimizer_with([0.01, 0.01, 0.01])
    control = DensityControl(DensitySettings(maximum_gaussians=maximum), EXTENT, 3)
    assert not control.limited
    for gradients in ([2e-3, 5e-3, 0], [0.0] * maximum):
        control.observe(seen_with_gradients(gradients), width=2, height=2)
        control.refine(optimizer, prune_large=False, generator=torch.Generator().manual_seed(0))
    assert control.limited == limited


def test_what_no_view_has_seen_takes_no_place_under_the_maximum() -> None:
    rendering = seen_with_gradients([2e-3, 5e-3, 0.0], radii=[3, 3, 0])
    gaussians = refined(optimizer_with([0.01, 0.01, 0.01]), rendering, maximum_gaussians=4)
    assert len(gaussians) == 4
    assert torch.equal(gaussians.means[3], gaussians.means[1])


def test_unseen_views_do_not_dilute_the_gradient() -> None:
    optimizer = optimizer_with([0.01])
    control = DensityControl(DensitySettings(), EXTENT, 1)
    control.observe(seen_with_gradients([3e-4]), 2, 2)
    control.observe(seen_with_gradients([0], radii=[0]), 2, 2)
    control.refine(optimizer, prune_large=False, generator=torch.Generator().manual_seed(0))
    assert len(optimizer.gaussians) == 2


def test_views_before_a_refinement_do_not_count_after_it() -> None:
    optimizer = optimizer_with([0.01])
    control = DensityControl(DensitySettings(), EXTENT, 1)
    for gradient, expected in ((1e-4, 1), (2.5e-4, 2)):
        control.observe(seen_with_gradients([gradient]), 2, 2)
        control.refine(optimizer, prune_large=False, generator=torch.Generator().manual_seed(0))
        assert len(optimizer.gaussians) == expected


def test_opacity_reset_lowers_only_what_is_higher() -> None:
    optimizer = optimizer_with([0.01, 0.01], opacity=0.5)
    with torch.no_grad():
        optimizer.gaussians["logit_opacities"][1] = math.log(0.006 / 0.994)
    DensityControl(DensitySettings(), EXTENT, 2).reset_opacity(optimizer)
    torch.testing.assert_close(optimizer.gaussians.opacities.detach(), torch.tensor([0.01, 0.006]))


def test_the_schedule_at_30000_is_that_of_3dgs() -> None:
    schedule = density_schedule(30_000)
    assert (schedule.start, schedule.stop, schedule.interval, schedule.opacity_reset_interval) == (
        500,
        15_000,
        100,
        3_000,
    )
    assert schedule.densifies_at(600)
    assert not schedule.densifies_at(500)
    assert schedule.resets_opacity_at(3_000)
    assert schedule.densifies_at(15_000)
    assert not schedule.resets_opacity_at(15_000)


def test_short_trainings_have_no_opacity_resets() -> None:
    """With a reset every 600 iterations, plain 3DGS lost 0.5 dB on test views of the bonsai."""
    schedule = density_schedule(12_000)
    assert not any(schedule.resets_opacity_at(iteration) for iteration in range(1, 12_001))
    assert density_schedule(15_000).resets_opacity_at(1_500)


def test_short_trainings_refine_every_50_iterations_at_the_most() -> None:
    """A mean gradient over fewer views says nothing."""
    schedule = density_schedule(3_000)
    refined_at = [iteration for iteration in range(1, 3_001) if schedule.densifies_at(iteration)]
    assert refined_at == list(range(100, 1_501, 50))


def test_the_position_rate_decays_exponentially() -> None:
    assert math.isclose(decayed(1e-2, 1e-4, 0), 1e-2)
    assert math.isclose(decayed(1e-2, 1e-4, 0.5), 1e-3)
    assert math.isclose(decayed(1e-2, 1e-4, 2), 1e-4)
