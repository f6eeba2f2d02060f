"""Adam, torch's own, without torch's compiler."""

from __future__ import annotations

from inspect import unwrap

import torch


class Adam(torch.optim.Adam):
    """To the bit what `torch.optim.Adam` does, for code that nobody compiles.

    torch wraps an optimizer's methods to keep its compiler out of them, and imports the compiler to do so: 2.1 s of a
    core (Zen 3, torch 2.13) in every process that trains, of which some train for no longer. Here they are called as
    written, without gradients, as those wrappers have it.
    """

    add_param_group = unwrap(torch.optim.Adam.add_param_group)
    zero_grad = unwrap(torch.optim.Adam.zero_grad)
    step = torch.no_grad()(unwrap(torch.optim.Adam.step))
