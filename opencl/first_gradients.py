"""Backward passes by kernels have no derivative of their own, and say so before anybody could go without it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import torch

Gradients = TypeVar("Gradients")


def first_gradients_only(backward: Callable[..., Gradients]) -> Callable[..., Gradients]:
    """For a Function's `backward`: `RuntimeError` where its gradients are to be differentiated again (`create_graph`).

    torch's own `once_differentiable` lets the gradients pass and waits for a second backward pass to reach them. It
    does not see one that reaches the inputs by what was saved of them (gx of f(x) depends on x even where the gradient
    that came in does not), and then that part is missing from the sum without a word.

    torch computes gradients with its grad mode on for `create_graph` alone: `retain_graph` and checkpoints, which
    recompute the forward pass on the way back, have it off here, and pass.
    """

    @functools.wraps(backward)
    def checked(ctx: Any, *gradients: Any) -> Gradients:
        if torch.is_grad_enabled():
            raise RuntimeError(
                f"{backward.__qualname__}: found create_graph=True, expected none: kernels compute first gradients "
                "only, and second ones would lack what goes through here. Leave create_graph out, or differentiate "
                "twice what is written in torch's own operations"
            )
        return backward(ctx, *gradients)

    return checked
