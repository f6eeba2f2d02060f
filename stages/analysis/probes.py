"""Features that hold no message, for a container's geometry and a message decoder that ought to show nothing of it."""

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
    """What the rows of one probe of one method's container are told apart by, where other rows name a method."""
    return f"{method}: {probe}"


def probed(name: str) -> tuple[str, str] | None:
    """The method and the probe of a `run_name`; None of what is none.

    >>> probed("gs_hider: own features"), probed("gs_hider")
    (('gs_hider', 'own features'), None)
    """
    method, _, probe = name.rpartition(": ")
    return (method, probe) if probe in PROBES else None


def probes(own: RawFeatures, foreign: RawFeatures | None, seed: int) -> dict[str, RawFeatures]:
    """Raw features by what was done to them; `foreign` are another container's, any number, of as many channels.

    Each Gaussian takes those of a Gaussian drawn at random. Raises `ValueError` where the channels differ in number.
    """
    generator = torch.Generator().manual_seed(seed)
    silenced = torch.randperm(own.shape[1], generator=generator)[: own.shape[1] // 2]
    halved = own.clone()
    halved[:, silenced] = SILENT
    found = {
        OWN: own,
        HALF: halved,
        NONE: torch.full_like(own, SILENT),
        MEAN: own.mean(dim=0).expand_as(own).contiguous(),
    }
    if foreign is not None:
        if foreign.shape[1] != own.shape[1]:
            raise ValueError(f"features of {own.shape[1]} and of {foreign.shape[1]} channels")
        rows = torch.randint(len(foreign), (len(own),), generator=generator)
        found[FOREIGN] = foreign[rows]
    return found
