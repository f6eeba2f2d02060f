"""How much of a message a reading shows: its PSNR, and measures of how recognisable it is.

A reading in negative or in false colours has a PSNR below that of a single colour, and yet anyone can recognise it. So
the PSNR is complemented by that after a fit to the true colours, and by the correlation of a view's reading with that
view's message and, as a control, with the message of the other views.
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
"""Weights of sRGB values, as in JPEG."""

Figures = dict[str, float]


def luma(picture: Float[Tensor, "H W 3"]) -> Float[Tensor, "H W"]:
    """Grey values of a picture in [0, 1]."""
    return picture @ torch.tensor(LUMA, dtype=picture.dtype)


def edges(grey: Float[Tensor, "H W"]) -> Float[Tensor, "H W"]:
    """The gradient's length at each pixel, from central differences, one-sided at the borders."""
    down, across = torch.gradient(grey)
    return (down.square() + across.square()).sqrt()


def picture_readings(
    readings: Sequence[Float[Tensor, "L H W C"]], views: Sequence[Observed]
) -> Iterator[tuple[int, int, Figures]]:
    """The position of the view, that of the message, and the figures of each reading, in three channels.

    Readings may exceed [0, 1], as half of a random decoder's output does. They are clamped, as by a screen, only for
    `psnr` and `psnr_covered`: an attacker who stretches a reading to recognise it loses nothing outside that range.

    - `psnr`: over the whole picture; NaN if the view shows nothing of the message;
    - `psnr_covered`, `psnr_constant`: of the reading and of the best single colour, as in `covered_psnrs`;
    - `psnr_coloured`: of the reading `with_true_colours`, over covered pixels;
    - `correlation`: the multiple correlation of the message's luminance with the channels, whatever their colours;
    - `correlation_others`: the mean of the same with the message of the other views; NaN if there are none.
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
    """A reading of one view in the truth's colours, by the affine map of its channels that best fits covered pixels.

    This is the best an attacker could get if told the colours: for three channels, the map has twelve coefficients.
    If the message covers nothing, the reading is returned unchanged.
    """
    mask = coverage >= COVERED
    if not mask.any():
        return reading
    regressors = neighbourhoods(reading, 1)
    return (regressors @ least_squares([regressors[mask]], [truth[mask]])).clamp(0, 1)
