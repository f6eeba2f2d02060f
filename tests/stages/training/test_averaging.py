"""Averages are over the last iterations, for Gaussians and networks alike."""

from __future__ import annotations

import torch

from stages.training.averaging import AVERAGED_SHARE, Averages
from stages.training.schedules import density_schedule
from tests.stages.training.trainings import prepared


def test_the_average_forgets_by_its_decay() -> None:
    training = prepared("gs_hider", 10)
    averages = Averages(0.75, 10)
    assert averages.first == 10 - AVERAGED_SHARE * 10
    expected = None
    for iteration in range(1, 11):
        training.step(iteration)
        averages.add(iteration, training.gaussians, training.method)
        sizes = training.gaussians["log_scales"].detach().clone()
        if iteration == averages.first:
            expected = sizes
        elif expected is not None:
            expected = 0.75 * expected + 0.25 * sizes
    assert expected is not None
    averages.apply(training.gaussians, training.method)
    torch.testing.assert_close(training.gaussians["log_scales"].detach(), expected)
    weight = training.method.networks["message_decoder"].state_dict()["0.weight"]
    assert torch.equal(weight, averages.values["networks/message_decoder/0.weight"])


def test_the_last_fifth_is_averaged_when_density_control_has_ended() -> None:
    """Rows that are added and removed have no average."""
    first = Averages(0.9, 30_000).first
    assert first == 24_000
    assert first > density_schedule(30_000).stop


def test_without_averaging_a_training_ends_with_its_last_values() -> None:
    training = prepared("plain", 10)
    averages = Averages(0.0, 10)
    averages.add(10, training.gaussians, training.method)
    before = training.gaussians.means.detach().clone()
    averages.apply(training.gaussians, training.method)
    assert not averages.values
    assert torch.equal(training.gaussians.means, before)
