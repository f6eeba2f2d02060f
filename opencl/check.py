"""`python -m opencl.check`: whether stages that draw find their device, asked before a run begins.

Exit status 2, with what is wrong, where they do not: nothing is there that is asked for, or NVIDIA's GPU, on which
torch would keep all tensors, is one that OpenCL does not see, so that a CPU would draw for days what the GPU draws in
an hour. It loads no more than it takes to list the devices, and torch only where NVIDIA's driver is without its OpenCL.
"""

from __future__ import annotations

import os
import sys

from opencl.cuda_driver import load_driver
from opencl.device import DEVICE_VARIABLE, choose_device, list_devices


def main() -> int:
    try:
        device = choose_device()
    except ValueError as error:
        remedy = f". Set {DEVICE_VARIABLE} to one of these, or unset it for the default one." if list_devices() else ""
        print(f"{error}{remedy}", file=sys.stderr)
        return 2
    if _tensors_are_where_nothing_draws():
        from opencl.nvidia import MISSING_ICD

        print(
            f"{MISSING_ICD}\nOr have {device.name} do all the work: {DEVICE_VARIABLE}={device.index}", file=sys.stderr
        )
        return 2
    return 0


def _tensors_are_where_nothing_draws() -> bool:
    """Whether torch works on an NVIDIA GPU that OpenCL does not see, and nobody asked for another device."""
    seen = any("nvidia" in device.handle.platform.name.lower() for device in list_devices())
    if os.environ.get(DEVICE_VARIABLE) or seen or not _has_driver():
        return False
    import torch

    return torch.version.cuda is not None and torch.cuda.is_available()


def _has_driver() -> bool:
    try:
        return load_driver() is not None
    except RuntimeError:  # it does not start, for torch neither
        return False


if __name__ == "__main__":
    sys.exit(main())
