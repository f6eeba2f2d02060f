"""Features without a message for a container's geometry, for which a message decoder should show nothing of it."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

OWN = "own features"
HALF, NONE, MEAN = "half of the channels zeroed", "all channels zeroed", "every Gaussian with the mean feature"
FOREIGN = "features of another scene"
PROBES = (OWN, FOREIGN, HALF, NONE, MEAN)
SILENT = -1e4
"""A raw feature whose sigmoid is zero."""

RawFeatures = Float[Tensor, "N M"]


def run_name(method: str, probe: str) -> str:
    """The name of a probe of a method's container, used in rows in place of the method."""
    return f"{method}: {probe}"


def probed(name: str) -> tuple[str, str] | None:
    """The method and the probe of a `run_name`; None if `name` is not one.

    >>> probed("gs_hider: own features"), probed("gs_hider")
    (('gs_hider', 'own features'), None)
    """
    method, _, probe = name.rpartition(": ")
    return (method, probe) if probe in PROBES else None


def probes(own: RawFeatures, foreign: Float[Tensor, "K M"] | None, seed: int) -> dict[str, RawFeatures]:
    """Raw features for each probe: the container's own ones, and what replaces them.

    `foreign` are those of another container, of at least one Gaussian: each Gaussian takes the features of one drawn at
    random. Without them, the FOREIGN probe is left out. Raises `ValueError` if the numbers of channels differ.
    """
    generator = torch.Generator().manual_seed(seed)
    silenced = torch.randperm(own.shape[1], generator=generator)[: own.shape[1] // 2]
    halved = own.clone()
    halved[:, silenced] = SILENT
    found = {
        OWN: own,
        HALF: halved,
        NONE: torch.full_like(own, SILENT),
        MEAN: own.sigmoid().mean(dim=0).logit().expand_as(own).contiguous(),
    }
    if foreign is not None:
        if foreign.shape[1] != own.shape[1]:
            raise ValueError(f"features of {own.shape[1]} and of {foreign.shape[1]} channels")
        rows = torch.randint(len(foreign), (len(own),), generator=generator)
        found[FOREIGN] = foreign[rows]
    return found
