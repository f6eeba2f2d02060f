"""Which OpenCL device is used: found, chosen by name, described."""

from __future__ import annotations

import functools
import os
import re
from dataclasses import dataclass

import pyopencl
from filelock import FileLock

from opencl.kernel_cache import reserve_kernel_cache
from opencl.pocl_processor import misnamed_processor, name_processor
from opencl.vendors import nvidia_named

DEVICE_VARIABLE = "GS_HIDER_DEVICE"
"""Environment variable that names the device where the caller does not."""

_POCL = "Portable Computing Language"


@dataclass(frozen=True)
class Device:
    """An OpenCL device and how to ask for it."""

    index: str
    """`platform:device`, counted from 0; changes with what is installed."""
    handle: pyopencl.Device

    @property
    def name(self) -> str:
        """Platform, its version and device, as users may name it by any part."""
        platform = self.handle.platform
        return f"{platform.name.strip()} ({platform.version.strip()}): {self.handle.name.strip()}"

    @property
    def is_cpu(self) -> bool:
        return bool(self.handle.type & pyopencl.device_type.CPU)

    @property
    def shares_memory(self) -> bool:
        """Whether kernels work on torch's own memory. PoCL's CPU devices do; elsewhere data are copied."""
        return self.is_cpu and self.handle.platform.name == _POCL

    def answers_to(self, name: str) -> bool:
        """Whether `name` is its index or part of its name; every device answers to an empty one."""
        return self.index == name if re.fullmatch(r"\d+:\d+", name) else name.lower() in self.name.lower()

    def describe(self) -> str:
        """One line for a log or a provenance record, the same whenever it is asked for.

        Memory is a GPU's own; of a CPU, PoCL tells what is free at the moment. A GPU's driver assembles the kernels:
        another version may make other bits.
        """
        kind = "CPU" if self.is_cpu else "GPU" if self.handle.type & pyopencl.device_type.GPU else "accelerator"
        units = self.handle.max_compute_units
        facts = [kind, f"{units} compute units"]
        if not self.is_cpu:
            facts += [f"{self.handle.global_mem_size / 2**30:.1f} GiB", f"driver {self.handle.driver_version}"]
        return f"{self.name} [{', '.join(facts)}]"

    def prepare(self) -> None:
        """Make sure that kernels can be built; `ValueError` with a way out where they cannot."""
        misnamed = misnamed_processor(self.handle)
        if misnamed is not None and name_processor(self.handle, misnamed) is None:
            raise ValueError(
                f"device {self.name}: this PoCL does not know the processor (it says {misnamed!r}) and cannot build "
                "for it; install a newer one (Debian and Ubuntu: apt install pocl-opencl-icd) or choose another with "
                f"{DEVICE_VARIABLE}"
            )


@functools.cache
def _kernel_cache() -> FileLock | None:
    """This process's directory of compiled kernels, held as long as the process lives."""
    return reserve_kernel_cache()


def list_devices() -> list[Device]:
    """Every OpenCL device of this machine; empty where no driver is installed."""
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
    """The device that `name`, or else the variable GS_HIDER_DEVICE, asks for: an index as `0:1`, or part of its name.

    Without either: the newest PoCL, or else another CPU, or else whatever there is; a GPU draws the CPU's tensors where
    it is asked for. `ValueError` lists what exists.
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
    """Sorts the best first."""
    version = [-int(number) for number in re.findall(r"\d+", device.handle.platform.version.partition("PoCL")[2])[:2]]
    return (not device.shares_memory, not device.is_cpu, version)
