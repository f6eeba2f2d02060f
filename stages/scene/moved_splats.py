"""Moving, mirroring and joining splats with view-dependent colours."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from stages.scene.gaussians import Gaussians
from stages.scene.similarity import Similarity
from stages.scene.spherical_harmonics import MAXIMUM_DEGREE, SH_REST, harmonics, harmonics_count

DIRECTIONS = 64
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))

MIRROR = np.diag([-1.0, 1.0, 1.0])
"""Maps x to -x."""


def moved(gaussians: Gaussians, similarity: Similarity) -> Gaussians:
    """Gaussians of the similarity's source world, in its target world, where they look the same.

    All spherical harmonics rotate along; other attributes, features included, stay as they are. N = 0 is allowed.
    """
    geometry = similarity.gaussians(
        *(gaussians[name].detach().double().numpy() for name in ("means", "quats", "log_scales"))
    )
    means, quats, log_scales = (torch.from_numpy(values).float() for values in geometry)
    changed = {"means": means, "quats": quats, "log_scales": log_scales}
    return gaussians.with_parameters(changed | _turned_attributes(gaussians, similarity.rotation))


def mirrored(gaussians: Gaussians) -> Gaussians:
    """The mirror image of Gaussians by `MIRROR`: mirrored cameras see the mirror images of the original pictures.

    All spherical harmonics are mirrored; other attributes stay as they are. Mirroring twice restores means, quaternions
    and scales bit for bit. N = 0 is allowed.
    """
    axes = torch.tensor([-1.0, 1.0, 1.0])
    turns = torch.tensor([1.0, 1.0, -1.0, -1.0])  # w x y z: M R M turns about the mirrored axis, the other way round
    changed = {"means": gaussians.means.detach() * axes, "quats": gaussians.quats.detach() * turns}
    return gaussians.with_parameters(changed | _turned_attributes(gaussians, MIRROR))


def _turned_attributes(gaussians: Gaussians, turn: Float64[np.ndarray, "3 3"]) -> dict[str, Tensor]:
    return {
        name: turned_harmonics(rest.flatten(0, -3), turn).reshape(rest.shape)
        for name, rest in gaussians.attributes.items()
        if name.endswith(SH_REST)  # the cover's, and those of messages, [N, ..., K, 3]
    }


def turned_harmonics(rest: Float[Tensor, "N K C"], rotation: Float64[np.ndarray, "3 3"]) -> Float[Tensor, "N K C"]:
    """Coefficients, beyond the constant one, of colours rotated by R: f'(R d) = f(d) for all directions d.

    R may also be a reflection. Each degree is transformed by itself; K = (degree + 1)² - 1, and K = 0 is allowed.
    """
    turned = torch.empty_like(rest)
    for degree in range(1, MAXIMUM_DEGREE + 1):
        first, last = harmonics_count(degree - 1) - 1, harmonics_count(degree) - 1
        if first < rest.shape[1]:
            matrix = _turn_of_degree(degree, rotation)
            turned[:, first:last] = (matrix @ rest[:, first:last].double()).to(rest.dtype)
    return turned


def joined(gaussians: Gaussians, added: Gaussians) -> Gaussians:
    """Both as one scene. If their harmonics differ in degree, the missing coefficients are zero."""
    count = max(each[SH_REST].shape[1] for each in (gaussians, added))
    both = [each.parameters | {SH_REST: _padded(each[SH_REST], count)} for each in (gaussians, added)]
    return Gaussians({name: torch.cat([each[name] for each in both]) for name in gaussians.parameters})


def degree_of(rest: Float[Tensor, "N K 3"]) -> int:
    """The degree of harmonics with K coefficients beyond the constant one. Raises `ValueError` if none has K."""
    counts = [harmonics_count(degree) - 1 for degree in range(MAXIMUM_DEGREE + 1)]
    return counts.index(rest.shape[1])


def _turn_of_degree(degree: int, rotation: Float64[np.ndarray, "3 3"]) -> Float[Tensor, "B B"]:
    """The matrix that rotates the 2·degree + 1 harmonics of one degree, fitted to their values in many directions.

    Rotated harmonics of a degree are linear combinations of the same harmonics, so the least-squares fit is exact.
    """
    directions = _even_directions()
    band = slice(harmonics_count(degree - 1), harmonics_count(degree))
    values = harmonics(directions, degree)[:, band]
    turned = harmonics(directions @ torch.as_tensor(rotation, dtype=torch.float64), degree)[:, band]
    return torch.linalg.lstsq(values, turned).solution


def _even_directions() -> Float[Tensor, "D 3"]:
    """Unit vectors on a spiral from pole to pole, nearly equally spaced."""
    height = 1 - (2 * np.arange(DIRECTIONS) + 1) / DIRECTIONS
    angle = GOLDEN_ANGLE * np.arange(DIRECTIONS)
    ring = np.sqrt(1 - height**2)
    return torch.from_numpy(np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1))


def _padded(rest: Float[Tensor, "N K 3"], count: int) -> Float[Tensor, "N count 3"]:
    return torch.cat([rest, rest.new_zeros(len(rest), count - rest.shape[1], 3)], dim=1)
