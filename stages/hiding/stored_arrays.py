"""The arrays of a stored container or secret: one for each attribute of Gaussians, and `network/weight` for weights."""

from __future__ import annotations

import numpy as np

from pipeline.artifact import Artifact


def attributes_of(artifact: Artifact) -> dict[str, np.ndarray]:
    """The arrays of `splats` or of a `container` that have a row for each of N Gaussians, by name; N = 0 is allowed."""
    return {name: artifact.read(name) for name in artifact.names if "/" not in name}


def weights_of(artifact: Artifact) -> dict[str, dict[str, np.ndarray]]:
    """The weights of all networks that a container or a secret holds, by network and name."""
    weights: dict[str, dict[str, np.ndarray]] = {}
    for array in artifact.names:
        network, _, weight = array.partition("/")
        if weight:
            weights.setdefault(network, {})[weight] = artifact.read(array)
    return weights
