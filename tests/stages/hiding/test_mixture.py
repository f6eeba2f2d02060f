"""Rows are orthonormal, and no direction is likelier than another."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stages.hiding.mixture import orthonormal_rows


@pytest.mark.parametrize(("count", "size"), [(3, 16), (16, 16), (20, 8)])
def test_as_many_as_fit_are_at_right_angles(count: int, size: int) -> None:
    rows = orthonormal_rows(count, size, np.random.default_rng(0))
    for block in rows.split(size):
        torch.testing.assert_close(block @ block.T, torch.eye(len(block)))


def test_none_leans_to_an_axis() -> None:
    """Over 500 keys, each mean is within five standard errors of zero, and about half of the draws are reflections."""
    drawn = torch.stack([orthonormal_rows(4, 4, np.random.default_rng(seed)) for seed in range(500)])
    assert drawn.mean(dim=0).abs().max() < 5 * 0.5 / 500**0.5
    assert (torch.linalg.det(drawn) > 0).float().mean().item() == pytest.approx(0.5, abs=0.12)
