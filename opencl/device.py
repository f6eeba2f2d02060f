"""Lists, selects and describes OpenCL devices."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass

import pyopencl
from filelock import FileLock

from opencl.kernel_cache import reserve_kernel_cache
from opencl.once import once
from opencl.pocl_processor import misnamed_processor, name_processor
from opencl.vendors import nvidia_named

DEVICE_VARIABLE = "GS_HIDER_DEVICE"
"""Environment variable that names the device if the caller does not."""

_POCL = "Portable Computing Language"


@dataclass(frozen=True)
class Device:
    """An OpenCL device and its index."""

    index: str
    """`platform:device`, both counted from 0. It depends on the drivers installed."""
    handle: pyopencl.Device

    @property
    def name(self) -> str:
        """Platform, its version, and device. Users may select the device by any part of this name."""
        platform = self.handle.platform
        return f"{platform.name.strip()} ({platform.version.strip()}): {self.handle.name.strip()}"

    @property
    def is_cpu(self) -> bool:
        return bool(self.handle.type & pyopencl.device_type.CPU)

    @property
    def shares_memory(self) -> bool:
        """Whether kernels work in place on torch's CPU memory. Only PoCL's CPU devices do."""
        return self.is_cpu and self.handle.platform.name == _POCL

    def answers_to(self, name: str) -> bool:
        """Whether `name` is the index or, ignoring case, a part of the name. An empty one matches every device."""
        return self.index == name if re.fullmatch(r"\d+:\d+", name) else name.lower() in self.name.lower()

    def describe(self) -> str:
        """One line for a log or a provenance record. It does not change between calls.

        A CPU's memory is left out, because PoCL reports what is free at the moment. A GPU's driver version is included,
        because the driver assembles the kernels: another version may give different bits.
        """
        kind = "CPU" if self.is_cpu else "GPU" if self.handle.type & pyopencl.device_type.GPU else "accelerator"
        units = self.handle.max_compute_units
        facts = [kind, f"{units} compute units"]
        if not self.is_cpu:
            facts += [f"{self.handle.global_mem_size / 2**30:.1f} GiB", f"driver {self.handle.driver_version}"]
        return f"{self.name} [{', '.join(facts)}]"

    def prepare(self) -> None:
        """Make sure that kernels can be built. Raises ValueError with a remedy if they cannot."""
        misnamed = misnamed_processor(self.handle)
        if misnamed is not None and name_processor(self.handle, misnamed) is None:
            raise ValueError(
                f"device {self.name}: this PoCL does not know the processor (it says {misnamed!r}) and cannot build "
                "for it; install a newer one (Debian and Ubuntu: apt install pocl-opencl-icd) or choose another with "
                f"{DEVICE_VARIABLE}"
            )


@once
def _kernel_cache() -> FileLock | None:
    """The lock on this process's directory of compiled kernels, held until the process ends."""
    return reserve_kernel_cache()


def list_devices() -> list[Device]:
    """All OpenCL devices of this machine. Empty if no driver is installed."""
    _kernel_cache()
    try:
        with nvidia_named():
            platforms = pyopencl.get_platforms()
    except pyopencl.LogicError:
        return []
    devices = []
    for platform_index, platform in enumerate(platforms):
        try:
            handles = platform.get_devices()
        except pyopencl.RuntimeError:
            handles = []
        devices += [Device(f"{platform_index}:{index}", handle) for index, handle in enumerate(handles)]
    return devices


def choose_device(name: str | None = None) -> Device:
    """The device that `name` or, if None, GS_HIDER_DEVICE selects: by an index such as `0:1`, or part of its name.

    Of several matching devices, and if nothing is selected, prefers the newest PoCL, then any other CPU, then any other
    device. GPUs come last, as a GPU should process CPU tensors only on request. Raises ValueError, which lists the
    devices, if none matches.
    """
    wanted = name if name is not None else os.environ.get(DEVICE_VARIABLE, "")
    devices = sorted(list_devices(), key=_preference)
    if not devices:
        raise ValueError("no OpenCL device found: install one, for a CPU with: pip install 'pyopencl[pocl]'")
    for device in devices:
        if device.answers_to(wanted):
            return device
    existing = "; ".join(f"{device.index} {device.name}" for device in devices)
    asked_by = "device" if name is not None else DEVICE_VARIABLE
    raise ValueError(f"{asked_by}: found {wanted!r}, expected an index or part of a name of one of: {existing}")


def _preference(device: Device) -> tuple[bool, bool, list[int]]:
    """Sort key: the preferred device first."""
    version = [-int(number) for number in re.findall(r"\d+", device.handle.platform.version.partition("PoCL")[2])[:2]]
    return (not device.shares_memory, not device.is_cpu, version)
