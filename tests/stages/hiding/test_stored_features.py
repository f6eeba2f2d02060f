"""Activated features are stored as logits, and clamped where they exceed what can be stored."""

from __future__ import annotations

import torch

from stages.hiding.stored_features import FARTHEST, stored


def test_what_is_stored_is_read_again() -> None:
    features = torch.rand(50, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 0.99 + 0.005
    assert torch.allclose(stored(features).double().sigmoid(), features, atol=1e-6)
    assert stored(features).dtype == torch.float32
    assert stored(features[:0]).shape == (0, 4)


def test_what_lies_beyond_is_finite_and_as_far_as_it_may_be() -> None:
    beyond = stored(torch.tensor([[-3.0, 0.0, 1.0, 7.0]], dtype=torch.float64)).double().sigmoid()
    expected = torch.tensor([[0.5 - FARTHEST, 0.5 - FARTHEST, 0.5 + FARTHEST, 0.5 + FARTHEST]], dtype=torch.float64)
    assert torch.allclose(beyond, expected, atol=1e-7)
