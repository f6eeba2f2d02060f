"""Another surrogate: who has views of the message paints them onto the Gaussians that the cover hardly shows.

Where these stand, how large and how opaque they are is published, under a seal as well. Nothing that is stored in their
features is read here: only colours are sought with which they show the views that leaked, and how much of each Gaussian
is the message's, by which what is blended is divided, as the owner's decoder does.
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
"""Of Adam, each of which sees one whole view."""

LEAST_SHARE = 0.03
"""Added to what is divided by: where next to nothing of the message is blended it stays black."""

RATE = 0.05


def painted_surrogate(
    gaussians: Gaussians,
    public: TellsShares,
    seen: Sequence[Observed],
    views: Sequence[Observed],
    seed: int,
    after_each: Callable[[], None],
) -> list[Float[Tensor, "L H W 3"]]:
    """What those Gaussians show of `views`, painted by the `seen` ones; `seed` decides the order of these.

    Σ w s c / (Σ w s + ε) of colours c and shares s, both sought, with the weights w of blending. What no seen view
    shows stays grey. Raises `ValueError` without any seen view.
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
    """`paint` are the colours of all messages and, last, the share; unactivated."""
    colors, share = paint[:, :-1].sigmoid(), paint[:, -1:].sigmoid()
    blended = splat(gaussians, torch.cat([share * colors, share], dim=1), view.camera).feature_map
    divided = blended[..., :-1] / (blended[..., -1:] + LEAST_SHARE)
    return torch.stack(divided.split(3, dim=-1))
