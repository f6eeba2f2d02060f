"""Random mixtures: which part of a feature is whose follows from the key, and no channel is anybody's own."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


def orthonormal_rows(count: int, size: int, generator: np.random.Generator) -> Float[Tensor, "count size"]:
    """Random directions at right angles to each other; where count > size, as many as fit at a time.

    None is likelier than another. For that, signs follow from the triangle's (Mezzadri 2007, "How to generate random
    matrices from the classical compact groups"): linear algebra's own lean the k-th away from axis k for every key.
    """
    blocks = []
    for start in range(0, count, size):
        rotation, triangle = np.linalg.qr(generator.standard_normal((size, size)))
        blocks.append((rotation * np.sign(triangle.diagonal()))[: min(size, count - start)])
    return torch.from_numpy(np.concatenate(blocks)).float()
