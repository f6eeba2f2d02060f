"""Least squares between pictures: how much of one a linear map of another explains."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

RIDGE = 1e-6
"""Of the mean square of the regressors: enough for channels that say the same."""


def neighbourhoods(channels: Float[Tensor, "H W C"], size: int = 3) -> Float[Tensor, "H W D"]:
    """Each pixel's `size` x `size` neighbours in all channels, zeros outside, and a constant one: D = C size² + 1."""
    height, width, count = channels.shape
    patches = torch.nn.functional.unfold(channels.permute(2, 0, 1)[None], size, padding=size // 2)
    gathered = patches[0].T.reshape(height, width, count * size**2)
    return torch.cat([gathered, torch.ones(height, width, 1, dtype=channels.dtype)], dim=-1)


def least_squares(
    regressors: Sequence[Float[Tensor, "*P D"]], targets: Sequence[Float[Tensor, "*P C"]]
) -> Float[Tensor, "D C"]:
    """The linear map from regressors to targets with the least squared error over all of them; sums run in float64.

    Raises `ValueError` without any.
    """
    if not regressors:
        raise ValueError("least squares of nothing")
    size, channels = regressors[0].shape[-1], targets[0].shape[-1]
    products = torch.zeros(size, size, dtype=torch.float64)
    moments = torch.zeros(size, channels, dtype=torch.float64)
    for given, wanted in zip(regressors, targets, strict=True):
        rows = given.reshape(-1, size).double()
        products += rows.T @ rows
        moments += rows.T @ wanted.reshape(-1, channels).double()
    ridge = RIDGE * products.diagonal().mean() * torch.eye(size, dtype=torch.float64)
    return torch.linalg.solve(products + ridge, moments).float()


def multiple_correlations(regressors: Float[Tensor, "*P D"], targets: Float[Tensor, "*P T"]) -> list[float]:
    """Of each target with its best linear prediction, from 0 to 1; the regressors hold a constant one.

    NaN for a target that is constant, as where a view shows nothing of a message: there is nothing to predict.
    """
    wanted = targets.reshape(-1, targets.shape[-1])
    rest = wanted - regressors.reshape(len(wanted), -1) @ least_squares([regressors], [targets])
    left, variance = rest.double().square().sum(0), (wanted - wanted.mean(0)).double().square().sum(0)
    return [
        max(0.0, 1 - unexplained / whole) ** 0.5 if whole > 0 else math.nan
        for unexplained, whole in zip(left.tolist(), variance.tolist(), strict=True)
    ]
