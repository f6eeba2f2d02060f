"""`python -m opencl.check`: whether stages that draw find their device, asked before a run begins.

Exit status 2, with what is wrong, where they do not: nothing is there that is asked for; or there is an NVIDIA GPU and
torch does not work on it, or OpenCL does not see it, so that a CPU would draw for days what the GPU draws in an hour.
Who wants the CPU says so, by GS_HIDER_DEVICE or, as to all of CUDA's programs, by an empty CUDA_VISIBLE_DEVICES. It
loads no more than it takes to list the devices, and torch only where there is an NVIDIA GPU.
"""

from __future__ import annotations

import os
import sys

from opencl.cuda_driver import load_driver
from opencl.device import DEVICE_VARIABLE, Device, choose_device, list_devices

VISIBLE_VARIABLE = "CUDA_VISIBLE_DEVICES"
"""CUDA's own environment variable: the GPUs that its programs see."""


def main() -> int:
    try:
        device = choose_device()
    except ValueError as error:
        remedy = f". Set {DEVICE_VARIABLE} to one of these, or unset it for the default one." if list_devices() else ""
        print(f"{error}{remedy}", file=sys.stderr)
        return 2
    faults = _faults_of_nvidia(device)
    if faults:
        other = choose_device("")
        way_out = [f"Or have {other.name} do all the work: {DEVICE_VARIABLE}={other.index}"] if other.is_cpu else []
        print("\n".join([*faults, *way_out]), file=sys.stderr)
        return 2
    return 0


def _faults_of_nvidia(chosen: Device) -> list[str]:
    """Why an NVIDIA GPU of this machine would fail, or be left idle though nobody asked for another device."""
    asked = bool(os.environ.get(DEVICE_VARIABLE))
    if (asked and not _is_nvidia(chosen)) or os.environ.get(VISIBLE_VARIABLE, "all").strip() in ("", "-1"):
        return []
    seen = any(map(_is_nvidia, list_devices()))
    try:
        started = load_driver() is not None
    except RuntimeError as error:
        if not seen and "NO_DEVICE" in str(error):
            return []
        return [f"NVIDIA's driver does not start ({error}): restart the machine, or install the driver again."]
    if not seen and not started:
        return []
    from opencl.nvidia import faults

    return faults(seen, asked)


def _is_nvidia(device: Device) -> bool:
    """As `nvidia.is_nvidia`, which loads torch."""
    return "nvidia" in device.handle.platform.name.lower()


if __name__ == "__main__":
    sys.exit(main())
