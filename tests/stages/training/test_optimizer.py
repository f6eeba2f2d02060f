"""Gaussians and their moments in Adam stay together when Gaussians are added and removed."""

from __future__ import annotations

import pytest
import torch

from stages.scene.gaussians import gaussians_at
from stages.training.optimizer import MOMENTS, GaussianOptimizer

RATES = {"means": 1e-2, "quats": 1e-2, "log_scales": 1e-2, "logit_opacities": 1e-2, "color": 1e-2}


def stepped_optimizer(count: int = 5) -> GaussianOptimizer:
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(count, 3, generator=generator).numpy()
    gaussians = gaussians_at(points, {"color": torch.rand(count, 3, generator=generator)})
    optimizer = GaussianOptimizer(gaussians, RATES)
    take_step(optimizer)
    return optimizer


def take_step(optimizer: GaussianOptimizer) -> None:
    torch.stack(
        [(tensor * (row + 1)).sum() for row, tensor in enumerate(optimizer.gaussians.parameters.values())]
    ).sum().backward()
    optimizer.step()


def test_kept_rows_go_on_as_if_nothing_had_happened() -> None:
    undisturbed, rearranged = stepped_optimizer(), stepped_optimizer()
    kept = torch.tensor([3, 0])
    added = {name: tensor.detach()[:1] for name, tensor in rearranged.gaussians.parameters.items()}
    rearranged.rearrange(kept, added)
    take_step(undisturbed)
    take_step(rearranged)
    for name, tensor in undisturbed.gaussians.parameters.items():
        assert torch.equal(rearranged.gaussians[name][:2], tensor[kept])
        assert len(rearranged.gaussians[name]) == 3


def test_each_row_keeps_its_own_moments_and_new_ones_have_none() -> None:
    optimizer = stepped_optimizer()
    (optimizer.gaussians["color"] * torch.arange(1, 6)[:, None]).sum().backward()
    optimizer.step()
    before = dict(optimizer.adam.state[optimizer.gaussians["color"]])
    kept = torch.tensor([3, 0])
    optimizer.rearrange(kept, {name: tensor[:1] for name, tensor in optimizer.gaussians.parameters.items()})
    after = optimizer.adam.state[optimizer.gaussians["color"]]
    for moment in MOMENTS:
        assert torch.equal(after[moment][:2], before[moment][kept])
        assert not after[moment][2].any()


def test_everything_can_go() -> None:
    optimizer = stepped_optimizer()
    optimizer.rearrange(
        torch.empty(0, dtype=torch.long),
        {name: tensor.detach()[:0] for name, tensor in optimizer.gaussians.parameters.items()},
    )
    assert len(optimizer.gaussians) == 0


def test_rearranging_copies_once_and_what_overwrites_stays_its_owners(monkeypatch: pytest.MonkeyPatch) -> None:
    optimizer, logits = stepped_optimizer(), torch.zeros(5)
    optimizer.overwrite("logit_opacities", logits)
    logits += 1
    assert not optimizer.gaussians["logit_opacities"].detach().any()
    monkeypatch.setattr(torch.Tensor, "clone", None)
    optimizer.rearrange(
        torch.tensor([3, 0]), {name: tensor[:1] for name, tensor in optimizer.gaussians.parameters.items()}
    )
    assert all(tensor.is_leaf and tensor.requires_grad for tensor in optimizer.gaussians.parameters.values())


def test_overwriting_forgets_the_moments() -> None:
    optimizer = stepped_optimizer()
    optimizer.overwrite("logit_opacities", torch.zeros(5))
    state = optimizer.adam.state[optimizer.gaussians["logit_opacities"]]
    assert not state["exp_avg"].any()
    assert torch.equal(optimizer.gaussians["logit_opacities"].detach(), torch.zeros(5))


def test_after_everything_is_replaced_adam_starts_anew() -> None:
    values = {name: tensor.detach().clone() for name, tensor in stepped_optimizer().gaussians.parameters.items()}
    stepped, fresh = (
        stepped_optimizer(),
        GaussianOptimizer(gaussians_at(torch.zeros(1, 3).numpy(), {"color": torch.zeros(1, 3)}), RATES),
    )
    for optimizer in (stepped, fresh):
        optimizer.replace_all(values)
        take_step(optimizer)
        take_step(optimizer)
    for name, tensor in fresh.gaussians.parameters.items():
        assert torch.equal(stepped.gaussians[name], tensor)


def test_a_parameter_without_a_rate_is_refused() -> None:
    gaussians = gaussians_at(torch.rand(2, 3).numpy(), {"other": torch.zeros(2, 1)})
    with pytest.raises(ValueError, match="other"):
        GaussianOptimizer(gaussians, RATES)


def test_gradients_far_smaller_than_adams_usual_epsilon_still_move() -> None:
    optimizer = GaussianOptimizer(gaussians_at(torch.zeros(2, 3).numpy(), {"color": torch.zeros(2, 3)}), RATES)
    (optimizer.gaussians["color"] * 1e-12).sum().backward()
    optimizer.step()
    torch.testing.assert_close(optimizer.gaussians["color"].detach(), torch.full((2, 3), -1e-2), rtol=2e-3, atol=0)
