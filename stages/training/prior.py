"""What Gaussians are held to whatever the photos show: to be transparent and small (3DGS-MCMC, Kheradmand et al. 2024).

What no photo speaks against stays where it helped one view by chance, before the eyes of another. There the weights are
0.01 in every step. Here they are those of a prior, counted once for all training views together: few photos leave much
open, many leave little.
"""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from stages.scene.gaussians import Gaussians


def prior(gaussians: Gaussians, opacity_weight: float, scale_weight: float, extent: float) -> Float[Tensor, ""] | None:
    """opacity_weight · mean α + scale_weight · mean s / extent; None where both weights are 0 or there is no Gaussian.

    Scales s and `extent`, that of the rig, in world units.
    """
    if len(gaussians) == 0 or opacity_weight == scale_weight == 0:
        return None
    return opacity_weight * gaussians.opacities.mean() + scale_weight / extent * gaussians.scales.mean()
