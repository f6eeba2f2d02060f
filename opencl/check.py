"""`python -m opencl.check`: checks, before a run begins, that its rendering stages will find their device.

Exits with status 2 and a message if the requested device does not exist, or if the machine has an NVIDIA GPU on which
torch does not work or which OpenCL does not see: a CPU would then render for days what the GPU renders in an hour. To
use the CPU on purpose, set GS_HIDER_DEVICE or, as for any CUDA program, set CUDA_VISIBLE_DEVICES to an empty string.
Imports only what is needed to list the devices, and torch only if there is an NVIDIA GPU.
"""

from __future__ import annotations

import os
import sys

from opencl.cuda_driver import load_driver
from opencl.device import DEVICE_VARIABLE, Device, choose_device, list_devices

VISIBLE_VARIABLE = "CUDA_VISIBLE_DEVICES"
"""CUDA's own environment variable, which lists the GPUs visible to its programs."""


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
    """Reasons why this machine's NVIDIA GPU would fail, or stay idle although no other device was requested."""
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
    """Like `nvidia.is_nvidia`, whose module imports torch."""
    return "nvidia" in device.handle.platform.name.lower()


if __name__ == "__main__":
    sys.exit(main())
