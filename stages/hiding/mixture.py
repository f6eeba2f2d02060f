"""Random mixtures: the key decides how pictures share a feature's dimensions; no channel belongs to one picture."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


def orthonormal_rows(count: int, size: int, generator: np.random.Generator) -> Float[Tensor, "count size"]:
    """Random orthonormal directions, uniformly distributed; if count > size, in blocks of at most `size` rows.

    To be uniform, signs follow from the diagonal of R (Mezzadri 2007, "How to generate random matrices from the
    classical compact groups"): with the signs of a plain QR decomposition, direction k would tend away from axis k for
    every key.
    """
    blocks = []
    for start in range(0, count, size):
        rotation, triangle = np.linalg.qr(generator.standard_normal((size, size)))
        blocks.append((rotation * np.sign(triangle.diagonal()))[: min(size, count - start)])
    return torch.from_numpy(np.concatenate(blocks)).float()
