"""Least squares between pictures: how much of one picture a linear map of another explains.

Sums over views take one view at a time: with its neighbourhoods, a view of the paper's size takes a gigabyte.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import reduce

import torch
from jaxtyping import Float
from torch import Tensor

RIDGE = 1e-6
"""Ridge regularisation, as a share of the regressors' mean square; enough for linearly dependent channels."""


def neighbourhoods(channels: Float[Tensor, "H W C"], size: int = 3) -> Float[Tensor, "H W D"]:
    """Each pixel's `size` x `size` neighbours in all channels, zero-padded, and a constant 1: D = C size² + 1."""
    height, width, count = channels.shape
    patches = torch.nn.functional.unfold(channels.permute(2, 0, 1)[None], size, padding=size // 2)
    gathered = patches[0].T.reshape(height, width, count * size**2)
    return torch.cat([gathered, torch.ones(height, width, 1, dtype=channels.dtype)], dim=-1)


def least_squares(
    regressors: Iterable[Float[Tensor, "*P D"]], targets: Iterable[Float[Tensor, "*P C"]]
) -> Float[Tensor, "D C"]:
    """The linear map from regressors to targets with the least squared error over all pairs; sums are in float64.

    Each iterable is consumed once, in order, so that generators can be passed. Raises `ValueError` if they are empty.
    """
    of_views = [_normal_equations(given, wanted) for given, wanted in zip(regressors, targets, strict=True)]
    if not of_views:
        raise ValueError("least squares of nothing")
    products, moments = (reduce(torch.add, sums) for sums in zip(*of_views, strict=True))
    ridge = RIDGE * products.diagonal().mean() * torch.eye(len(products), dtype=torch.float64)
    return torch.linalg.solve(products + ridge, moments).float()


def _normal_equations(
    regressors: Float[Tensor, "*P D"], targets: Float[Tensor, "*P C"]
) -> tuple[Float[Tensor, "D D"], Float[Tensor, "D C"]]:
    """XᵀX and Xᵀy over one view, in float64."""
    rows = regressors.reshape(-1, regressors.shape[-1]).double()
    return rows.T @ rows, rows.T @ targets.reshape(-1, targets.shape[-1]).double()


def covariance(maps: Sequence[Float[Tensor, "*P M"]]) -> Float[Tensor, "M M"]:
    """The covariance matrix of the channels over the pixels of all maps, in float64."""
    size = maps[0].shape[-1]
    pixels = max(sum(each.numel() // size for each in maps), 1)
    mean = torch.stack([each.reshape(-1, size).sum(dim=0, dtype=torch.float64) for each in maps]).sum(dim=0) / pixels
    products = torch.zeros(size, size, dtype=torch.float64)
    for each in maps:
        centred = each.reshape(-1, size).double() - mean
        products += centred.T @ centred
    return products / pixels


def multiple_correlations(regressors: Float[Tensor, "*P D"], targets: Float[Tensor, "*P T"]) -> list[float]:
    """The correlation of each target with its best linear prediction, from 0 to 1.

    The regressors must include a constant 1. NaN for a constant target, as in a view that shows nothing of a message.
    """
    wanted = targets.reshape(-1, targets.shape[-1])
    rest = wanted - regressors.reshape(len(wanted), -1) @ least_squares([regressors], [targets])
    left, variance = rest.double().square().sum(0), (wanted - wanted.mean(0)).double().square().sum(0)
    return [
        max(0.0, 1 - unexplained / whole) ** 0.5 if whole > 0 else math.nan
        for unexplained, whole in zip(left.tolist(), variance.tolist(), strict=True)
    ]
