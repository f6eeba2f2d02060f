"""The Gaussians of a scene: stored, unactivated parameters, and the only place where they are activated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

GEOMETRY = ("means", "quats", "log_scales", "logit_opacities")
"""Parameters of every method's Gaussians; a method adds its own attributes (`sh_base`, `raw_features`, …)."""

NEIGHBOURS = 3
SMALLEST_DISTANCE = 1e-4
"""In world units, for coincident points. 3DGS uses the root of 1e-7, three times as much."""
INITIAL_OPACITY = 0.1


@dataclass
class Gaussians:
    """N Gaussians: the paper's μ, q, s and α as stored (unactivated) tensors, and the method's attributes.

    `means [N,3]` in world units, `quats [N,4]` (w x y z, any length), `log_scales [N,3]`, `logit_opacities [N]`. Every
    tensor of `parameters` has N rows, N = 0 included; density control adds and removes whole rows.
    """

    parameters: dict[str, Tensor]

    def __len__(self) -> int:
        return len(self.parameters["means"])

    def __getitem__(self, name: str) -> Tensor:
        return self.parameters[name]

    @property
    def means(self) -> Float[Tensor, "N 3"]:
        """Centres, in world units."""
        return self.parameters["means"]

    @property
    def quats(self) -> Float[Tensor, "N 4"]:
        """Rotations as stored: quaternions w x y z of any length."""
        return self.parameters["quats"]

    @property
    def scales(self) -> Float[Tensor, "N 3"]:
        """Standard deviations along the Gaussians' own axes, in world units."""
        return self.parameters["log_scales"].exp()

    @property
    def opacities(self) -> Float[Tensor, " N"]:
        """Activated opacities, in (0, 1)."""
        return self.parameters["logit_opacities"].sigmoid()

    @property
    def attributes(self) -> dict[str, Tensor]:
        """The parameters that the method adds to the geometry."""
        return {name: tensor for name, tensor in self.parameters.items() if name not in GEOMETRY}

    @property
    def device(self) -> torch.device:
        """The device of all tensors."""
        return self.means.device

    def select(self, rows: Tensor) -> Gaussians:
        """The Gaussians at these rows, given by number, in their order, or as a mask of N booleans."""
        return Gaussians({name: tensor[rows] for name, tensor in self.parameters.items()})

    def with_parameters(self, changed: Mapping[str, Tensor]) -> Gaussians:
        """The same Gaussians with these parameters, of N rows each, in place of their own or beside them."""
        return Gaussians({**self.parameters, **changed})

    def to(self, device: torch.device | str) -> Gaussians:
        """The same Gaussians on a device; tensors already there are shared."""
        return Gaussians({name: tensor.to(device) for name, tensor in self.parameters.items()})


def neighbour_distances(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
    """Root mean square distance to the three nearest other points, 3DGS's initial scale; 1 for a single point."""
    if len(points) < 2:
        return np.ones(len(points))
    neighbours = min(NEIGHBOURS, len(points) - 1)
    distances, _ = cKDTree(points).query(points, k=neighbours + 1)
    return np.sqrt(np.mean(distances[:, 1:] ** 2, axis=1)).clip(min=SMALLEST_DISTANCE)


def gaussians_at(points: Float[np.ndarray, "N 3"], attributes: Mapping[str, Tensor]) -> Gaussians:
    """A round Gaussian of opacity 0.1 at each point, as wide as the distance to its neighbours (3DGS, section 5.1).

    `attributes` are the method's own tensors, N rows each.
    """
    count = len(points)
    log_scales = np.log(neighbour_distances(points))[:, None].repeat(3, axis=1)
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1
    logit = float(np.log(INITIAL_OPACITY / (1 - INITIAL_OPACITY)))
    geometry = {
        "means": torch.as_tensor(points, dtype=torch.float32).clone(),
        "quats": quats,
        "log_scales": torch.as_tensor(log_scales, dtype=torch.float32),
        "logit_opacities": torch.full((count,), logit),
    }
    return Gaussians(geometry | {name: tensor.clone() for name, tensor in attributes.items()})


def rotation_matrices(quats: Float[Tensor, "N 4"]) -> Float[Tensor, "N 3 3"]:
    """Rotation matrices of quaternions w x y z, which are normalised first."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)
