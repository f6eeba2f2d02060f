"""The loop learns, gives the same bits twice, and follows its schedules and its objective."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
import torch

from stages.hiding.rendering import COVER
from stages.imaging.ssim import ssim
from stages.timing.stopwatch import OTHER, Stopwatch, watching
from stages.training.averaging import Averages
from stages.training.density_control import DensitySettings
from stages.training.loop import Training
from stages.training.objectives import (
    Compared,
    FixedView,
    PictureTerm,
    cover_term,
    hiding_terms,
    picture_loss,
    total_loss,
)
from stages.training.sampling import ViewSampler
from stages.training.schedules import DensitySchedule
from tests.stages.training.trainings import MESSAGE, prepared


def trained(method_name: str, iterations: int, seed: int = 0, precision: str = "float32"):
    training = prepared(method_name, iterations, seed, precision)
    return training, training.run(lambda: None)


def penalty_of(training: Training) -> float:
    """What the method's penalty adds to the loss of a step."""
    penalty = training.method.penalty(training.gaussians)
    return 0.0 if penalty is None else float(penalty.detach()) / len(training.views.cameras)


@pytest.fixture
def threads() -> Iterator[Callable[[int], None]]:
    """A function that sets torch's number of threads for one test."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.parametrize(
    ("method", "iterations", "precision"),
    [
        ("plain", 200, "float32"),
        ("sh", 200, "float32"),
        ("decoder", 200, "float32"),
        ("gs_hider", 60, "float32"),
        ("gs_hider", 60, "bfloat16"),
        ("homogeneous", 60, "float32"),
        ("homogeneous", 60, "bfloat16"),
    ],
)
def test_it_learns(method: str, iterations: int, precision: str) -> None:
    training = prepared(method, iterations, precision=precision)
    before = penalty_of(training)
    rows = training.run(lambda: None)
    losses = [row.value for row in rows if row.quantity == "loss"]
    assert losses[-1] - penalty_of(training) < 0.6 * (losses[0] - before)
    assert {row.message for row in rows} == ({None} if method == "plain" else {None, MESSAGE})
    for picture in {row.message for row in rows}:
        first, *_, last = (row.value for row in rows if row.quantity == "psnr" and row.message == picture)
        assert last > first + 10, picture


@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
@pytest.mark.parametrize("method", ["plain", "sh", "decoder", "gs_hider", "homogeneous"])
def test_the_same_seed_and_threads_give_the_same_bits(
    method: str, precision: str, number: int, threads: Callable[[int], None]
) -> None:
    threads(number)
    (first, first_rows), (second, second_rows) = (trained(method, 12, precision=precision) for _ in range(2))
    assert first_rows == second_rows
    for name, tensor in first.gaussians.parameters.items():
        assert torch.equal(tensor, second.gaussians[name])
    for name, network in first.method.networks.items():
        for weight, tensor in network.state_dict().items():
            assert torch.equal(tensor, second.method.networks[name].state_dict()[weight])


def test_a_stopwatch_changes_no_bits_and_names_every_part() -> None:
    unwatched, rows = trained("homogeneous", 12)
    with watching(Stopwatch()) as stopwatch:
        watched, watched_rows = trained("homogeneous", 12)
    assert rows == watched_rows
    assert torch.equal(unwatched.gaussians.means, watched.gaussians.means)
    forward = {"data", "rasterizer", "decoders", "loss", "activations", "optimizer", "density control", "figures"}
    backward = {"rasterizer", "decoders", "loss", "activations"}
    expected = {(name, "forward") for name in forward | {OTHER}} | {(name, "backward") for name in backward}
    assert stopwatch.seconds.keys() == expected


def test_a_penalty_counts_once_for_all_views() -> None:
    training = prepared("homogeneous", 1)
    expected = penalty_of(training)
    assert expected > 0
    weighed = training.step(1)["loss"]
    without = prepared("homogeneous", 1)
    without.method.penalty = lambda gaussians: None  # type: ignore[method-assign]  # the same training but for this
    assert weighed - without.step(1)["loss"] == pytest.approx(expected, rel=1e-4)


def test_another_seed_gives_others() -> None:
    assert not torch.equal(trained("plain", 5)[0].gaussians.means, trained("plain", 5, seed=1)[0].gaussians.means)


def test_the_order_of_views_and_the_places_of_children_follow_the_seed() -> None:
    training = prepared("plain", 5)
    drawn = []
    for seed in (0, 1, 1):
        again = Training(
            training.gaussians,
            training.method,
            training.views,
            training.terms,
            replace(training.settings, seed=seed),
        )
        views = [again.sampler.draw() for _ in range(12)]
        drawn.append((views, torch.randn(3, generator=again.generator).tolist()))
    assert drawn[1] == drawn[2]
    assert all(first != second for first, second in zip(drawn[0], drawn[1], strict=True))


def test_every_view_once_a_pass() -> None:
    sampler = ViewSampler(5, seed=3)
    passes = [[sampler.draw() for _ in range(5)] for _ in range(4)]
    assert all(sorted(views) == list(range(5)) for views in passes)
    assert len({tuple(views) for views in passes}) > 1


def test_schedules_may_end_before_the_training_as_in_the_released_code() -> None:
    """50,000 iterations with 3DGS's schedule of 30,000: density control until 15,000, final rates from 30,000 on."""
    training = prepared("gs_hider", 50_000)
    training.settings = replace(
        training.settings, schedule_share=0.6, final_rate_share=0.1, attribute_rates={"raw_features": 1.0}, extent=3.0
    )
    scheduled = Training(
        training.gaussians, training.method, training.views, training.terms, training.settings, training.fixed
    )
    assert scheduled.schedule.stop == 15_000
    rates = []
    for iteration in (30_000, 50_000):
        scheduled.step(iteration)
        assert scheduled.network_optimizer is not None
        assert scheduled.network_optimizer.param_groups[0]["lr"] == pytest.approx(1e-4)
        rates.append({group["name"]: group["lr"] for group in scheduled.optimizer.adam.param_groups})
    assert rates[0] == rates[1]
    assert rates[1]["raw_features"] == pytest.approx(0.1)
    assert rates[1]["means"] == pytest.approx(3 * 1.6e-6), "in units of the scene"


@pytest.mark.parametrize("goes_on", [False, True])
def test_trained_gaussians_show_all_their_harmonics_from_the_start(goes_on: bool) -> None:
    training = prepared("plain", 1000)
    training.settings = replace(training.settings, goes_on=goes_on)
    before = training.gaussians["sh_rest"].detach().clone()
    training.step(1)
    assert torch.equal(training.gaussians["sh_rest"].detach(), before) is not goes_on


def test_a_fixed_view_is_compared_with_its_own_truth() -> None:
    training = prepared("sh", 10)
    camera = training.views.cameras[2]
    truth = torch.full((camera.height, camera.width, 3), 255, dtype=torch.uint8)
    fixed = [FixedView(PictureTerm(MESSAGE, 0.5, 0.2), camera, truth)]
    training = Training(
        training.gaussians, training.method, training.views, [cover_term(0.2)], training.settings, fixed
    )
    with torch.no_grad():
        picture = training.method.render(training.gaussians, camera, 0.1, [MESSAGE]).pictures[MESSAGE]
    assert training.step(1)[MESSAGE] == pytest.approx(float((picture.clamp(0, 1) - 1).square().mean()))


def test_the_last_refinement_follows_the_gradients_up_to_it() -> None:
    training = prepared("plain", 10, density=DensitySettings(gradient_threshold=1e-12, maximum_gaussians=60))
    training.schedule = DensitySchedule(start=0, stop=1, interval=1, opacity_reset_interval=11)
    training.step(1)
    assert len(training.gaussians) > 40


def test_opacities_are_lowered_when_a_reset_is_due() -> None:
    training = prepared("plain", 10)
    training.schedule = DensitySchedule(start=10, stop=10, interval=10, opacity_reset_interval=3)
    largest = []
    for iteration in (1, 2, 3):
        training.step(iteration)
        largest.append(training.gaussians.opacities.max().item())
    assert min(largest[:2]) > 0.05
    assert largest[2] == pytest.approx(0.01)


def test_overgrown_gaussians_go_once_an_opacity_reset_has_passed() -> None:
    """They survive the iteration of the first reset itself, which refines before it resets."""
    training = prepared("plain", 10, density=DensitySettings(gradient_threshold=1e9))
    training.schedule = DensitySchedule(start=0, stop=10, interval=3, opacity_reset_interval=3)
    with torch.no_grad():
        training.gaussians["log_scales"].fill_(-4)
        training.gaussians["log_scales"][0] = 0  # the limit is a tenth of the extent, which is 1
    counts = []
    for iteration in range(1, 7):
        training.step(iteration)
        counts.append(len(training.gaussians))
    assert counts == [40] * 5 + [39]


def test_total_loss_is_the_cover_plus_lambda_times_every_message() -> None:
    generator = torch.Generator().manual_seed(0)
    names = [COVER, "a", "b"]
    pictures = {name: torch.rand(12, 12, 3, generator=generator) for name in names}
    truths = {name: torch.rand(12, 12, 3, generator=generator) for name in names}
    losses = {name: picture_loss(pictures[name], truths[name], 0.2 if name == COVER else 0.4) for name in names}
    expected = losses[COVER] + 0.5 * (losses["a"] + losses["b"])
    terms = hiding_terms(["a", "b"], 0.5, ssim_weight_cover=0.2, ssim_weight_message=0.4)
    compared = [Compared(term, pictures[term.picture], truths[term.picture]) for term in terms]
    torch.testing.assert_close(total_loss(compared), expected)


def test_a_picture_costs_its_difference_and_its_dissimilarity() -> None:
    """Eq. 6 and 7, with γ = β = 0.2."""
    generator = torch.Generator().manual_seed(1)
    picture, truth = (torch.rand(12, 12, 3, generator=generator) for _ in range(2))
    expected = 0.8 * (picture - truth).abs().mean() + 0.2 * (1 - ssim(picture, truth))
    torch.testing.assert_close(picture_loss(picture, truth, 0.2), expected)


def test_a_training_ends_with_its_averages() -> None:
    training = prepared("gs_hider", 10)
    training.averages = Averages(0.75, 10)
    training.run(lambda: None)
    averages = training.averages.values
    assert torch.equal(training.gaussians.means.detach(), averages["gaussians/means"])
    weight = training.method.networks["scene_decoder"].state_dict()["0.weight"]
    assert torch.equal(weight, averages["networks/scene_decoder/0.weight"])


def test_equal_pictures_cost_nothing() -> None:
    picture = torch.rand(12, 12, 3, generator=torch.Generator().manual_seed(0))
    assert float(picture_loss(picture, picture, 0.2)) == pytest.approx(0, abs=1e-6)
