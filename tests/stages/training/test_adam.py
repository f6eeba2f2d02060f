"""Our Adam takes the steps of torch's, and does not import torch's compiler."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

from stages.training.adam import Adam

TRAINS = """
import sys, torch
from stages.training.adam import Adam
weights = torch.ones(3, requires_grad=True)
adam = Adam([weights], fused=True)
weights.sum().backward()
adam.step()
adam.zero_grad(set_to_none=True)
print(weights.grad is None, "torch._dynamo" in sys.modules)
"""


def test_the_compiler_is_not_imported() -> None:
    done = subprocess.run([sys.executable, "-c", TRAINS], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False"]


@pytest.mark.parametrize("fused", [True, False])
def test_it_takes_torchs_steps(fused: bool) -> None:
    generator = torch.Generator().manual_seed(0)
    start, pulls = torch.rand(7, generator=generator), torch.rand(5, 7, generator=generator) - 0.5
    ours, theirs = (start.clone().requires_grad_() for _ in range(2))
    optimizers = (
        Adam([{"params": [ours], "lr": 0.01}], eps=1e-15, fused=fused),
        torch.optim.Adam([{"params": [theirs], "lr": 0.01}], eps=1e-15, fused=fused),
    )
    for pull in pulls:
        for weights, optimizer in zip((ours, theirs), optimizers, strict=True):
            (weights * pull).square().sum().backward()
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        assert torch.equal(ours, theirs)
    assert ours.requires_grad
