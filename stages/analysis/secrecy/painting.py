"""A surrogate that paints leaked views of the message onto the Gaussians that hardly belong to the cover.

Their positions, sizes and opacities are published even under a seal. The surrogate ignores their features. It only fits
a colour for each Gaussian, so that they show the views that leaked, and a share that is the message's. Blended colours
are divided by the blended share, as in the owner's decoder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.secrecy.apart import TellsShares, hardly_shown
from stages.analysis.secrecy.observing import Observed
from stages.hiding.rendering import splat
from stages.scene.gaussians import Gaussians
from stages.training.adam import Adam

STEPS = 400
"""Adam's steps, each on one whole view."""

LEAST_SHARE = 0.03
"""ε, added to the divisor, so that pixels with next to nothing of the message stay black."""

RATE = 0.05


def painted_surrogate(
    gaussians: Gaussians,
    public: TellsShares,
    seen: Sequence[Observed],
    views: Sequence[Observed],
    seed: int,
    after_each: Callable[[], None],
) -> list[Float[Tensor, "L H W 3"]]:
    """The messages in `views`, from Gaussians painted by the `seen` views; `seed` decides which view each step sees.

    Pictures are Σ w s c / (Σ w s + ε) with blending weights w and fitted colours c and shares s. What no seen view
    shows stays grey. Raises `ValueError` if no view was seen.
    """
    if not seen:
        raise ValueError("without a view there is nothing to paint")
    generator = np.random.default_rng(seed)
    few = hardly_shown(gaussians, public)
    few = Gaussians({name: values.detach() for name, values in few.parameters.items()})
    paint = torch.zeros(len(few), 3 * len(seen[0].truths) + 1, requires_grad=True)
    adam = Adam([paint], lr=RATE)
    for _ in range(STEPS):
        view = seen[int(generator.integers(len(seen)))]
        loss = (_shown(few, paint, view) - view.truths).square().mean()
        adam.zero_grad(set_to_none=True)
        loss.backward()
        adam.step()
        after_each()
    with torch.no_grad():
        return [_shown(few, paint, view) for view in views]


def _shown(gaussians: Gaussians, paint: Float[Tensor, "N C"], view: Observed) -> Float[Tensor, "L H W 3"]:
    """The messages in one view; `paint` holds the colours for all messages and, last, the share, all as logits."""
    colors, share = paint[:, :-1].sigmoid(), paint[:, -1:].sigmoid()
    blended = splat(gaussians, torch.cat([share * colors, share], dim=1), view.camera).feature_map
    divided = blended[..., :-1] / (blended[..., -1:] + LEAST_SHARE)
    return torch.stack(divided.split(3, dim=-1))
