"""Deterministic backward passes, on whichever device pictures are rendered."""

from __future__ import annotations

from contextlib import AbstractContextManager

import torch


def in_one_thread() -> AbstractContextManager[None]:
    """A context in which backward always visits operations in the same order.

    Otherwise torch runs one thread per device. If tensors on a GPU are rendered elsewhere, with copies, their timing
    determines the order in which gradients are summed, and so their last bits. With a single device it changes nothing.
    """
    return torch.autograd.set_multithreading_enabled(False)
