"""How much of the messages a seal leaves open, because the scene decoder reads it, too.

With few channels for many messages, the message decoder's rows cannot be orthogonal to the scene decoder's. What both
read cannot be encrypted: the cover would change.
"""

from __future__ import annotations

import torch
from jaxtyping import Float64
from torch import Tensor

from stages.hiding.coupled import FEATURES
from stages.hiding.sealing import Sealable, read_basis
from stages.scene.gaussians import Gaussians

HARDLY = 0.1
"""The cover's share below which a Gaussian hardly belongs to it: a stranger would look at these. With 0.25 and 0.5,
they show less of the fox's message: r = 0.82 and 0.70, instead of 0.84."""


@torch.no_grad()
def share_left_open(gaussians: Gaussians, method: Sealable) -> float:
    """Of what the message decoder reads, the share of its variance that what the scene decoder reads explains, 0 to 1.

    Over Gaussians that hardly belong to the cover, by least squares: an upper bound for strangers who look for linear
    traces, who would have to know part of the message to find them. `gaussians` are those before the seal, N = 0
    allowed; 0 if no Gaussian counts, or nothing varies. `method` must have its messages.
    """
    counts = method.cover_shares(gaussians).cpu() < HARDLY
    centred = gaussians[FEATURES][counts.to(gaussians.device)].cpu().double().sigmoid() - 0.5
    readings = _about_mean(centred @ method.rows_of_messages().cpu().double().T)
    public = _about_mean(centred @ read_basis(method))
    rest = readings - public @ (torch.linalg.pinv(public) @ readings)
    whole = float(readings.square().sum())
    return 1 - float(rest.square().sum()) / whole if whole > 0 else 0.0


def _about_mean(values: Float64[Tensor, "N K"]) -> Float64[Tensor, "N K"]:
    return values - values.mean(dim=0) if len(values) else values
