"""Noise, quantisation and stripping change stored values as much as they say, and leave the original alone."""

from __future__ import annotations

import pytest
import torch

from stages.analysis.attacks.catalogue import ATTACKS
from stages.analysis.attacks.noise import noise
from stages.analysis.attacks.quantisation import SEVERITIES, quantisation
from stages.analysis.attacks.stripping import stripping
from tests.stages.analysis.attacks.containers import METHODS, target_and_owner


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


@pytest.mark.parametrize("severity", [0.01, 0.1, 1.0])
def test_noise_has_the_sigma_that_it_says(severity: float) -> None:
    target, _ = target_and_owner("gs_hider", 5000)
    before = target.gaussians["raw_features"].clone()
    attacked = noise(["raw_features"])(target, severity, generator()).gaussians["raw_features"]
    measured = (attacked - before).std(dim=0) / before.std(dim=0)
    assert torch.allclose(measured, torch.full((16,), severity), rtol=0.05)
    assert torch.equal(target.gaussians["raw_features"], before)


@pytest.mark.parametrize("method", METHODS)
def test_noise_on_colours_reaches_all_of_the_methods_attributes_and_nothing_else(method: str) -> None:
    target, _ = target_and_owner(method)
    attacked = noise([])(target, 0.1, generator()).gaussians
    for name, values in target.gaussians.parameters.items():
        assert torch.equal(attacked[name], values) == (name not in target.gaussians.attributes)


def test_stronger_noise_is_the_same_noise_scaled() -> None:
    target, _ = target_and_owner("gs_hider")
    weak, strong = (noise(["means"])(target, size, generator()).gaussians.means for size in (0.1, 0.2))
    assert torch.allclose(strong - target.gaussians.means, 2 * (weak - target.gaussians.means), atol=1e-6)


def test_noise_on_rotations_does_not_depend_on_the_lengths_of_quaternions() -> None:
    target, _ = target_and_owner("gs_hider")
    turns = torch.nn.functional.normalize(torch.randn(200, 4, generator=torch.Generator().manual_seed(1)), dim=1)
    lengths = torch.linspace(0.1, 9, 200)[:, None]
    one, other = (target.with_parameters({"quats": each}) for each in (turns, lengths * turns))
    found = [noise(["quats"])(each, 0.1, generator()).gaussians["quats"] for each in (one, other)]
    torch.testing.assert_close(found[0], found[1])


@pytest.mark.parametrize("bits", SEVERITIES[1:])
def test_quantised_columns_hold_as_many_values_as_there_are_steps(bits: float) -> None:
    target, _ = target_and_owner("gs_hider", 2000)
    attacked = quantisation(target, bits).gaussians
    features, before = attacked["raw_features"], target.gaussians["raw_features"]
    assert len(features[:, 0].unique()) <= 2**bits
    step = (before.amax(dim=0) - before.amin(dim=0)) / (2**bits - 1)
    assert ((features - before).abs() <= step / 2 + 1e-5).all()
    places = (features - before.amin(dim=0)) / step
    assert (places - places.round()).abs().max() < 1e-3
    assert (attacked.means - target.gaussians.means).abs().max() < 2 / 2**16


def test_half_precision() -> None:
    target, _ = target_and_owner("gs_hider")
    attacked = quantisation(target, 16).gaussians
    assert torch.equal(attacked["raw_features"], target.gaussians["raw_features"].half().float())
    assert (attacked.means - target.gaussians.means).abs().max() < 2 / 2**16, "positions are finer"


def test_the_severity_says_that_positions_keep_16_bits_in_equal_steps() -> None:
    target, _ = target_and_owner("gs_hider")
    finest, coarsest = (quantisation(target, bits).gaussians.means for bits in (SEVERITIES[0], SEVERITIES[-1]))
    assert torch.equal(finest, coarsest)
    assert "positions always 16, in equal steps" in ATTACKS["quantisation"].severity


def test_stripping_takes_what_3dgs_does_not_have() -> None:
    taken = {}
    for method in METHODS:
        target, _ = target_and_owner(method)
        attacked = stripping(target, 1.0, generator()).gaussians
        taken[method] = {name for name, values in attacked.parameters.items() if not values.any()}
    assert taken == {
        "sh": {"message_sh_base", "message_sh_rest"},
        "decoder": set(),
        "gs_hider": {"raw_features"},
        "homogeneous": {"raw_features"},
    }


def test_a_share_is_stripped() -> None:
    target, _ = target_and_owner("sh")
    attacked = stripping(target, 0.25, generator()).gaussians["message_sh_base"]
    assert int((attacked == 0).all(dim=-1).sum()) == 50
