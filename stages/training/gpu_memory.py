"""Telling what to change when the GPU has too little memory for a training."""

from __future__ import annotations

import torch

from pipeline.errors import UserError


def too_large(error: torch.OutOfMemoryError, where: str, remedy: str, of_what: str = "") -> UserError:
    """The error to raise for `error`: at `where`, the iteration, in a training `of_what`, if that is known.

    `remedy` ends the sentence that says what to change about the training itself.
    """
    reason = str(error).splitlines()[0]
    return UserError(
        "the GPU has too little memory for this training",
        where=where,
        found=f"{of_what}; {reason}" if of_what else reason,
        remedy="If other stages or programs use the GPU: --workers 1, or stop them; the training then goes on from its "
        f"last checkpoint. Otherwise {remedy}.",
    )
