"""Backward passes that give the same bits every time, wherever pictures are drawn."""

from __future__ import annotations

from contextlib import AbstractContextManager

import torch


def in_one_thread() -> AbstractContextManager[None]:
    """Inside, backward goes through all operations in one order.

    Else torch has a thread for each device, and which is first decides in which order gradients are added, and so their
    last bits, wherever tensors of a GPU are drawn elsewhere, with copies. On one device alone it changes nothing.
    """
    return torch.autograd.set_multithreading_enabled(False)
