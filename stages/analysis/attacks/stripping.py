"""Stripping: attributes that 3DGS does not have are zeroed."""

from __future__ import annotations

import torch

from stages.analysis.attacks.target import Target


def stripping(target: Target, share: float, generator: torch.Generator) -> Target:
    """Zero all attributes that 3DGS does not have, for this share of the Gaussians, drawn at random.

    With a share of 1, nothing is left but what a 3DGS file holds. This removes the message of 3DGS+SH and leaves its
    cover, while features carry both. (The attributes are zeroed, not deleted, so that the owner's decoder still runs:
    it shows the grey that zeros stand for.) The attacker knows only the container. The container must have such
    attributes.
    """
    chosen = torch.randperm(len(target.gaussians), generator=generator)[: round(share * len(target.gaussians))]

    def stripped(values: torch.Tensor) -> torch.Tensor:
        changed = values.clone()
        changed[chosen] = 0
        return changed

    return target.with_parameters({name: stripped(values) for name, values in target.own_attributes.items()})
