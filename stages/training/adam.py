"""torch's Adam, without importing torch's compiler."""

from __future__ import annotations

from inspect import unwrap

import torch


class Adam(torch.optim.Adam):
    """Bit for bit equal to `torch.optim.Adam`, for code that is never compiled.

    torch wraps an optimizer's methods to keep its compiler out of them, and imports the compiler to do so. That takes
    2.1 s of a core (Zen 3, torch 2.13) in every process that trains, and some train for no longer. Here, the methods
    are unwrapped, and `step` runs without gradients, as in those wrappers.
    """

    add_param_group = unwrap(torch.optim.Adam.add_param_group)
    zero_grad = unwrap(torch.optim.Adam.zero_grad)
    step = torch.no_grad()(unwrap(torch.optim.Adam.step))
