"""Stopping a diverged training at once, instead of returning a result of NaN."""

from __future__ import annotations

import math

from pipeline.errors import UserError


def refuse_divergence(loss: float, iteration: int) -> None:
    """Raise `UserError` if the loss is NaN or infinite; `iteration` counts from 1."""
    if not math.isfinite(loss):
        raise UserError(
            "the training has diverged",
            where=f"iteration {iteration}",
            found=f"a loss of {loss}",
            expected="a finite loss",
            remedy="Lower the learning rates; if they are the defaults, check the photos and poses, and a method of "
            "your own.",
        )
