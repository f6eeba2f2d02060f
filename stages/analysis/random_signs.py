"""Random signs, for estimates by Hutchinson's method: sums with random signs stand for all values at once."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def random_signs(values: Float[Tensor, "*shape"], generator: torch.Generator) -> Float[Tensor, "*shape"]:
    """1 or -1 for each value, with equal chances, on the values' device; `generator` is on the CPU."""
    return torch.randint(0, 2, values.shape, generator=generator).to(values.device) * 2.0 - 1
