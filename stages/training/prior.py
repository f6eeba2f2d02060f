"""A prior on Gaussians, whatever the photos show: transparent and small (3DGS-MCMC, Kheradmand et al. 2024).

A Gaussian that no photo contradicts persists where it happened to help one view, and may then obstruct another. In
3DGS-MCMC, the weights are 0.01 in every step. Here, the prior counts once for all training views together: few photos
leave much undetermined, many leave little.
"""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from stages.scene.gaussians import Gaussians


def prior(gaussians: Gaussians, opacity_weight: float, scale_weight: float, extent: float) -> Float[Tensor, ""] | None:
    """opacity_weight · mean α + scale_weight · mean s / extent; None if both weights are 0 or there are no Gaussians.

    Scales s and the rig's `extent` are in world units.
    """
    if len(gaussians) == 0 or opacity_weight == scale_weight == 0:
        return None
    return opacity_weight * gaussians.opacities.mean() + scale_weight / extent * gaussians.scales.mean()
