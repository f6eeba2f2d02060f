"""Memory for what the rasterizer makes."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

_NUMPY = {torch.float32: np.float32, torch.float64: np.float64, torch.int32: np.int32, torch.int64: np.int64}


def empty(*shape: int, dtype: torch.dtype) -> Tensor:
    """An uninitialised CPU tensor.

    NumPy allocates it: it asks Linux for huge pages, torch does not by default, and the first touch of 60 MB then takes
    4 ms in place of 23.
    """
    return torch.from_numpy(np.empty(shape, _NUMPY[dtype]))
