"""A guard for backward passes computed by kernels, which cannot be differentiated again."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import torch

Gradients = TypeVar("Gradients")


def first_gradients_only(backward: Callable[..., Gradients]) -> Callable[..., Gradients]:
    """Decorate a Function's `backward` to raise RuntimeError if its result is to be differentiated (`create_graph`).

    torch's own `once_differentiable` returns the gradients, and raises an error only if a second backward pass reaches
    them. It misses the dependence on saved inputs: the gradient g·f'(x) depends on x even if the incoming g does not.
    That part of the second gradient would be missing without an error.

    torch enables its grad mode in backward passes only for `create_graph`. `retain_graph` and checkpointing, which
    recomputes the forward pass during the backward pass, leave it off here and therefore work.
    """

    @functools.wraps(backward)
    def checked(ctx: Any, *gradients: Any) -> Gradients:
        if torch.is_grad_enabled():
            raise RuntimeError(
                f"{backward.__qualname__}: found create_graph=True, expected none: kernels compute first gradients "
                "only, and second gradients would miss this operation's contribution. Leave create_graph out, or "
                "differentiate twice what is written in torch's own operations"
            )
        return backward(ctx, *gradients)

    return checked
