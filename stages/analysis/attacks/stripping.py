"""Attributes that 3DGS does not have, taken away."""

from __future__ import annotations

import torch

from stages.analysis.attacks.target import Target


def stripping(target: Target, share: float, generator: torch.Generator) -> Target:
    """Set every attribute that a viewer of 3DGS would not know to zero, for this share of the Gaussians at random.

    The attacker knows the container alone; with a share of 1 the file holds what 3DGS's does. Of 3DGS+SH that takes the
    message and leaves the cover; features carry both. (The attributes are zero instead of gone, so that the owner's
    decoder still runs: it shows the grey that zeros mean.) Not for containers without such attributes.
    """
    chosen = torch.randperm(len(target.gaussians), generator=generator)[: round(share * len(target.gaussians))]

    def stripped(values: torch.Tensor) -> torch.Tensor:
        changed = values.clone()
        changed[chosen] = 0
        return changed

    return target.with_parameters({name: stripped(values) for name, values in target.own_attributes.items()})
