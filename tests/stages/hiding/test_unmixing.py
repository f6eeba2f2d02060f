"""Maps of features: exact where features were mixed, simple where that suffices, and none where there is only noise."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.hiding.unmixing import unmixing

COUNT, CHANNELS = 800, 5


def features(seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    spreads = torch.linspace(0.05, 2, CHANNELS, dtype=torch.float64)
    return (spreads * torch.randn(COUNT, CHANNELS, generator=generator, dtype=torch.float64) + 1).sigmoid()


def turn(seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.linalg.qr(torch.randn(CHANNELS, CHANNELS, generator=generator, dtype=torch.float64)).Q


def noise(sigma: float, seed: int = 1) -> torch.Tensor:
    return sigma * torch.randn(COUNT, CHANNELS, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.05, 1))
def test_every_turn_is_undone(seed: int, scale: float) -> None:
    wanted = features()
    seen = 0.5 + scale * (wanted - 0.5) @ turn(seed)
    back = unmixing(seen, wanted)
    assert back is None if torch.allclose(seen, wanted, atol=1e-4) else back is not None
    if back is not None:
        assert torch.allclose(back(seen), wanted, atol=1e-8)


def test_what_is_left_out_is_told_by_what_is_left() -> None:
    wanted = features()
    wanted[:, 0] = 0.1 + 0.4 * wanted[:, 1] + 0.3 * wanted[:, 2]
    dropped = wanted.clone()
    dropped[:, 0] = dropped[:, 0].mean()
    twice = torch.cat([wanted, wanted[:, :2]], dim=1) @ torch.eye(7).double().flip(0)
    unevenly_shrunk = wanted * torch.logspace(-3, 0, CHANNELS, dtype=torch.float64)
    for seen in (dropped, wanted[:, 1:], twice, unevenly_shrunk):
        back = unmixing(seen, wanted)
        assert back is not None
        assert torch.allclose(back(seen), wanted, atol=1e-6)


@pytest.mark.parametrize("share", [0.1, 0.4, 0.45])
def test_other_changes_of_some_do_not_count(share: float) -> None:
    wanted = features()
    changed = wanted.clone()
    changed[: round(share * COUNT)] = 0.99
    assert unmixing(changed, wanted) is None
    back = unmixing(changed @ turn(2), wanted)
    assert back is not None
    rest = slice(round(share * COUNT), None)
    assert torch.allclose(back(changed @ turn(2))[rest], wanted[rest], atol=1e-8)


def test_noise_asks_for_no_map_and_does_not_spoil_a_turn() -> None:
    wanted = features()
    noisy = wanted + noise(0.03)
    assert unmixing(noisy, wanted) is None
    back = unmixing(noisy @ turn(3), wanted)
    assert back is not None
    own = (back(noisy @ turn(3)) - noisy).square().mean().sqrt()
    centred, aim = noisy - noisy.mean(dim=0), wanted - wanted.mean(dim=0)
    drawn = (centred @ torch.linalg.lstsq(centred, aim).solution - centred).square().mean().sqrt()
    assert own < drawn / 3, "the noise stays, and little else is changed: least squares alone draw to the mean"


def test_features_that_are_all_alike_become_the_published_mean() -> None:
    wanted = features()
    seen = torch.full_like(wanted, 0.1)
    back = unmixing(seen, wanted)
    assert back is not None
    assert (back(seen) - wanted.mean(dim=0)).norm(dim=1).max() < 0.2
