"""Results with their gradients, for comparing two ways of computing them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


def with_gradients(result: Tensor, leaves: Sequence[Tensor]) -> list[Tensor]:
    """The result, and the gradients of a sum that weighs each of its values differently."""
    weights = torch.linspace(-1, 2, result.numel(), dtype=result.dtype).view(result.shape)
    return [result.detach(), *torch.autograd.grad((weights * result).sum(), leaves)]
