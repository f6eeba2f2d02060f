"""Refusing a diverged training instead of returning a result of NaN."""

from __future__ import annotations

import math

from pipeline.errors import UserError
from stages.scene.gaussians import Gaussians

REMEDY = "Lower the learning rates; if they are the defaults, check the photos and poses, and a method of your own."


def refuse_divergence(loss: float, iteration: int) -> None:
    """Raise `UserError` if the loss is NaN or infinite; `iteration` counts from 1."""
    if not math.isfinite(loss):
        raise UserError(
            "the training has diverged",
            where=f"iteration {iteration}",
            found=f"a loss of {loss}",
            expected="a finite loss",
            remedy=REMEDY,
        )


def refuse_not_finite(gaussians: Gaussians) -> None:
    """Raise `UserError` if a Gaussian has a value that is NaN or infinite: no picture shows it, so no loss does."""
    for name, values in gaussians.parameters.items():
        wrong = int((~values.isfinite()).reshape(len(values), -1).any(dim=1).sum()) if len(values) else 0
        if wrong:
            raise UserError(
                "the training has diverged",
                where=f"the Gaussians' {name}",
                found=f"NaN or infinity in {wrong} of {len(gaussians)}",
                expected="finite numbers",
                remedy=REMEDY,
            )
