"""How much of a message a reading shows: in decibels where it is a picture, and as a correlation where it need not be.

A reading in negative, or in false colours, has a PSNR below that of one colour, and anyone can recognise it all the
same. So correlations stand beside the decibels: of a view's reading with that view's message, and, as the control,
with the message of the other views.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.fidelity import covered_figures
from stages.analysis.leakage import correlation
from stages.analysis.secrecy.observing import Observed
from stages.imaging.psnr import psnr

LUMINANCE = (0.299, 0.587, 0.114)
"""Of sRGB values, as in JPEG."""

Figures = dict[str, float]


def luminance(picture: Float[Tensor, "H W 3"]) -> Float[Tensor, "H W"]:
    """Grey values of a picture in [0, 1]."""
    return picture @ torch.tensor(LUMINANCE, dtype=picture.dtype)


def edges(grey: Float[Tensor, "H W"]) -> Float[Tensor, "H W"]:
    """The length of the gradient, by central differences within."""
    down, across = torch.gradient(grey)
    return (down.square() + across.square()).sqrt()


def picture_readings(
    readings: Sequence[Float[Tensor, "L H W 3"]], views: Sequence[Observed]
) -> Iterator[tuple[int, int, Figures]]:
    """View, message and figures of readings that are pictures: `psnr`, `psnr_covered`, `psnr_constant`, `correlation`
    and `correlation_others`, the last two without sign, of luminances; the last is NaN where there is no other view.
    """
    for message in range(len(readings[0]) if readings else 0):
        greys = [luminance(reading[message].clamp(0, 1)) for reading in readings]
        truths = [luminance(seen.truths[message]) for seen in views]
        for view, ((own, others), seen) in enumerate(zip(matched(greys, truths), views, strict=True)):
            picture, truth = readings[view][message], seen.truths[message]
            covered = covered_figures(picture, truth, seen.coverage[message])
            yield (
                view,
                message,
                {
                    "psnr": psnr(picture, truth),
                    "psnr_covered": covered["psnr_covered"],
                    "psnr_constant": covered["psnr_constant"],
                    "correlation": own,
                    "correlation_others": others,
                },
            )


def matched(
    readings: Sequence[Float[Tensor, "H W"]], truths: Sequence[Float[Tensor, "H W"]]
) -> list[tuple[float, float]]:
    """For each view |correlation| of its reading with its own truth, and the mean of those with the other views'.

    The second is the control: what a reading has in common with any picture of the message.
    """
    arrays = [(reading.numpy(), truth.numpy()) for reading, truth in zip(readings, truths, strict=True)]
    found = []
    for view, (reading, _) in enumerate(arrays):
        values = [abs(correlation(reading, truth)) for _, truth in arrays]
        own = values.pop(view)
        found.append((own, float(np.mean(values)) if values else math.nan))
    return found
