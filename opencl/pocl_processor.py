"""Makes the PoCL from PyPI compile for processors that are newer than its LLVM.

PoCL 3.0, the newest on PyPI, asks its LLVM 14 for the name of the processor. For a processor that LLVM does not know,
such as AMD Zen 5, the answer is "generic", which clang then rejects, so that no kernel builds: "unknown target CPU
'generic'" (github.com/pocl/pocl/issues/1049). LLVM takes AMD Zen 4 for "znver3", which has no AVX-512, while PoCL links
its built-in functions for AVX-512. If a kernel calls one of these on 512 bits (the square root of a double8), LLVM
aborts the process with "Cannot select". No setting changes either. The name is a string in PoCL's device structure.
This module overwrites it, in this process only, with the closest processor that LLVM 14 knows.
"""

from __future__ import annotations

import ctypes
import os
import platform
import struct
from pathlib import Path

import pyopencl

from opencl.once import once

_ZEN_3 = "znver3"
_DEVICE_BYTES = 2048
"""Bytes searched in PoCL's device structure. It is shorter; stale copies of the same pointer may lie behind it."""

_HASWELL = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm", "popcnt", "rdrand", "fsgsbase"}
_AVX_512 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "adx", "aes", "clwb", "pclmulqdq"}
"""Instruction sets of LLVM's `skx` beyond its `haswell`, as named in /proc/cpuinfo."""


def misnamed_processor(device: pyopencl.Device) -> str | None:
    """The wrong processor name in a PoCL device whose LLVM does not recognise the processor. None if it is right."""
    name = device.version.rstrip().rpartition("-")[2]
    if device.platform.name != "Portable Computing Language":
        return None
    return name if name == "generic" or (name == _ZEN_3 and _processor_flags() >= _AVX_512) else None


def closest_known_processor(flags: set[str]) -> str:
    """The best x86 processor known to LLVM 14 whose instructions are all among `flags` (from /proc/cpuinfo).

    The name has at most seven characters, or six with AVX-512, because it overwrites "generic" or "znver3". `skx` is
    the server core of Skylake, with AVX-512.

    >>> closest_known_processor({"sse2"})
    'x86-64'
    """
    if flags >= _HASWELL | _AVX_512:
        return "skx"
    return "haswell" if flags >= _HASWELL else "x86-64"


@once
def name_processor(device: pyopencl.Device, misnamed: str) -> str | None:
    """Overwrite the name `misnamed` in PoCL's memory. Returns the new name, or None if that is not safe.

    Cached, as a device's version string keeps the old name after the replacement.
    """
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        return None
    name = closest_known_processor(_processor_flags())
    addresses = _addresses_of_name(device.int_ptr, misnamed.encode() + b"\0")
    if len(addresses) != 1 or len(name) > len(misnamed):
        return None
    ctypes.memmove(addresses.pop(), name.encode() + b"\0", len(name) + 1)
    return name


def _processor_flags() -> set[str]:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("flags"):
            return set(line.split(":", 1)[1].split())
    return set()


def _writable_regions() -> list[tuple[int, int]]:
    regions = []
    for line in Path("/proc/self/maps").read_text().splitlines():
        bounds, permissions, *_ = line.split()
        if permissions.startswith("rw"):
            low, high = (int(bound, 16) for bound in bounds.split("-"))
            regions.append((low, high))
    return regions


def _addresses_of_name(structure: int, name: bytes) -> set[int]:
    """Addresses in writable memory to which a pointer in the structure leads and which hold the name."""
    regions = _writable_regions()
    size = next((min(_DEVICE_BYTES, high - structure) for low, high in regions if low <= structure < high), 0)
    found = set()
    memory = os.open("/proc/self/mem", os.O_RDONLY)  # reading a bad address fails instead of ending the process
    try:
        for (pointer,) in struct.iter_unpack("P", os.pread(memory, size // 8 * 8, structure)):
            inside = any(low <= pointer and pointer + len(name) <= high for low, high in regions)
            if inside and os.pread(memory, len(name), pointer) == name:
                found.add(pointer)
    except OSError:
        return set()
    finally:
        os.close(memory)
    return found
