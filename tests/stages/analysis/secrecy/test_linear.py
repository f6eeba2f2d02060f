"""Sums over views are sums over all their pixels, with the neighbourhoods of at most two views in memory."""

from __future__ import annotations

import weakref
from types import ModuleType

import numpy as np
import pytest
import torch

from stages.analysis.secrecy import blind, linear_surrogate
from stages.analysis.secrecy.conditions import UNEXPLAINED
from stages.analysis.secrecy.linear import covariance, least_squares, neighbourhoods
from stages.hiding.method import build_method
from stages.scene.gaussians import Gaussians
from tests.stages.analysis.secrecy.observations import views


def test_sums_are_those_over_all_pixels() -> None:
    generator = torch.Generator().manual_seed(0)
    maps = [5 + torch.randn(height, 7, 3, generator=generator) for height in (4, 9, 1)]
    pixels = torch.cat([each.reshape(-1, 3) for each in maps])
    assert covariance(maps).numpy() == pytest.approx(np.cov(pixels.double().numpy().T, bias=True), abs=1e-12)
    targets = [each[..., :1] - 2 * each[..., 2:] for each in maps]
    together = least_squares([pixels], [torch.cat([each.reshape(-1, 1) for each in targets])])
    assert torch.allclose(least_squares(iter(maps), iter(targets)), together, atol=1e-6)


@pytest.mark.parametrize("module", [blind, linear_surrogate], ids=["unexplained", "surrogate"])
def test_neighbourhoods_are_held_of_one_view_or_two(module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the paper's size, those of one view take a gigabyte."""
    observed = views(torch.eye(6), 5)
    held: list[weakref.ref[torch.Tensor]] = []
    most = 0

    def counted(channels: torch.Tensor) -> torch.Tensor:
        nonlocal most
        made = neighbourhoods(channels)
        held.append(weakref.ref(made))
        most = max(most, sum(each() is not None for each in held))
        return made

    monkeypatch.setattr(module, "neighbourhoods", counted)
    if module is blind:
        public = build_method("sh", {"sh_degree": 0})
        assert len(blind.blind_readings(Gaussians({}), public, observed, 0)[UNEXPLAINED]) == 5
    else:
        assert len(linear_surrogate.linear_surrogate(observed, observed)) == 5
    assert len(held) == 10
    assert most <= 2
