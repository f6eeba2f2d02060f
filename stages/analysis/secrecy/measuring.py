"""How much of a message a reading shows: in decibels as it is, and as far as it can be recognised.

A reading in negative, or in false colours, has a PSNR below that of one colour, and anyone can recognise it all the
same. So beside the decibels stand those with the true colours, and a correlation: of a view's reading with that view's
message, and, as the control, with the message of the other views.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.fidelity import COVERED, covered_psnrs, where_seen
from stages.analysis.secrecy.linear import least_squares, multiple_correlations, neighbourhoods
from stages.analysis.secrecy.observing import Observed
from stages.imaging.metric_table import mean_of_known
from stages.imaging.psnr import psnr

LUMA = (0.299, 0.587, 0.114)
"""Of sRGB values, as in JPEG."""

Figures = dict[str, float]


def luma(picture: Float[Tensor, "H W 3"]) -> Float[Tensor, "H W"]:
    """Grey values of a picture in [0, 1]."""
    return picture @ torch.tensor(LUMA, dtype=picture.dtype)


def edges(grey: Float[Tensor, "H W"]) -> Float[Tensor, "H W"]:
    """The length of the gradient, by central differences within."""
    down, across = torch.gradient(grey)
    return (down.square() + across.square()).sqrt()


def picture_readings(
    readings: Sequence[Float[Tensor, "L H W C"]], views: Sequence[Observed]
) -> Iterator[tuple[int, int, Figures]]:
    """View, message and figures of readings in three channels, in [0, 1] or beyond.

    Only the decibels of the reading as it is take it as a screen would, clamped. An attacker who stretches it to be
    recognised loses nothing that lies outside [0, 1], as half of what random decoders put out does.

    - `psnr`, NaN where the view shows nothing of the message, and, as in `covered_psnrs`, `psnr_covered` and, of the
      best picture of one colour, `psnr_constant`;
    - `psnr_coloured`, over covered pixels, of the reading `with_true_colours`;
    - `correlation`: the multiple correlation of the message's luminance with the channels, whatever their colours;
    - `correlation_others`: the mean of the same with the message of the other views, NaN where there is none.
    """
    for message in range(len(readings[0]) if readings else 0):
        greys = torch.stack([luma(seen.truths[message]) for seen in views], dim=-1)
        for view, seen in enumerate(views):
            picture, truth, coverage = readings[view][message], seen.truths[message], seen.coverage[message]
            coloured = with_true_colours(picture, truth, coverage)
            values = multiple_correlations(neighbourhoods(picture, 1), greys)
            own = values.pop(view)
            yield (
                view,
                message,
                {
                    **where_seen({"psnr": psnr(picture, truth)}, truth),
                    **covered_psnrs(picture, truth, coverage),
                    "psnr_coloured": psnr(coloured, truth, coverage >= COVERED),
                    "correlation": own,
                    "correlation_others": mean_of_known(values),
                },
            )


def with_true_colours(
    reading: Float[Tensor, "H W C"], truth: Float[Tensor, "H W 3"], coverage: Float[Tensor, "H W"]
) -> Float[Tensor, "H W 3"]:
    """A reading of one view with the colours of the truth: the affine map of its channels that fits the covered pixels.

    What a reading is at its best, if somebody told the attacker what is which colour: of three channels twelve numbers.
    As it is where the message covers nothing.
    """
    mask = coverage >= COVERED
    if not mask.any():
        return reading
    regressors = neighbourhoods(reading, 1)
    return (regressors @ least_squares([regressors[mask]], [truth[mask]])).clamp(0, 1)
