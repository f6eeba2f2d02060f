"""The harmonics are orthonormal, with the signs of 3DGS."""

from __future__ import annotations

import math

import pytest
import torch

from stages.scene.spherical_harmonics import harmonics


def test_orthonormal_over_the_sphere() -> None:
    polar_nodes = torch.linspace(-1, 1, 401, dtype=torch.float64)[:-1] + 1 / 400
    azimuths = torch.linspace(0, 2 * math.pi, 65, dtype=torch.float64)[:-1]
    z, phi = (grid.reshape(-1) for grid in torch.meshgrid(polar_nodes, azimuths, indexing="ij"))
    ring = (1 - z * z).sqrt()
    values = harmonics(torch.stack([ring * phi.cos(), ring * phi.sin(), z], dim=-1), 3)
    products = values.T @ values * (4 * math.pi / len(z))
    torch.testing.assert_close(products, torch.eye(16, dtype=torch.float64), atol=1e-4, rtol=0)


def test_signs_of_the_first_degree_are_those_of_3dgs() -> None:
    values = harmonics(torch.eye(3), 1)
    signs = torch.tensor([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])
    torch.testing.assert_close(values[:, 1:], 0.4886025 * signs)


def test_degree_out_of_range() -> None:
    with pytest.raises(ValueError, match="degree"):
        harmonics(torch.eye(3), 4)
