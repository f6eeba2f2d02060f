"""PoCL from PyPI on processors that are younger than it: tell it which one to compile for.

PoCL 3.0, the newest on PyPI, asks its LLVM 14 for the processor's name. For one that LLVM does not know (AMD Zen 5,
say) the answer is "generic", which clang then refuses, so that no kernel builds at all: "unknown target CPU 'generic'"
(github.com/pocl/pocl/issues/1049). AMD Zen 4 it takes for "znver3", which has no AVX-512, but links PoCL's built-in
functions for AVX-512: where a kernel calls one on 512 bits (the square root of a double8), LLVM ends the process with
"Cannot select". There is no setting for either. The name is a string in PoCL's description of the device; it is
replaced there, in this process only, by the closest processor that LLVM 14 knows.
"""

from __future__ import annotations

import ctypes
import functools
import os
import platform
import struct
from pathlib import Path

import pyopencl

_ZEN_3 = "znver3"
_DEVICE_BYTES = 2048
"""Of PoCL's device structure, which is shorter; what lies behind it may hold stale copies of the same pointer."""

_HASWELL = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm", "popcnt", "rdrand", "fsgsbase"}
_AVX_512 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "adx", "aes", "clwb", "pclmulqdq"}
"""What LLVM's Skylake has over its Haswell, by the names of /proc/cpuinfo."""


def misnamed_processor(device: pyopencl.Device) -> str | None:
    """The processor's name in a PoCL device whose LLVM does not know it or takes it for a lesser one; else None."""
    name = device.version.rstrip().rpartition("-")[2]
    if device.platform.name != "Portable Computing Language":
        return None
    return name if name == "generic" or (name == _ZEN_3 and _processor_flags() >= _AVX_512) else None


def closest_known_processor(flags: set[str]) -> str:
    """The best x86 processor in LLVM 14's list whose instructions are all among `flags` (those of /proc/cpuinfo).

    At most seven letters, six with AVX-512: the name takes the place of "generic" or of "znver3". `skx` is Skylake's
    server core, with AVX-512.

    >>> closest_known_processor({"sse2"})
    'x86-64'
    """
    if flags >= _HASWELL | _AVX_512:
        return "skx"
    return "haswell" if flags >= _HASWELL else "x86-64"


@functools.cache
def name_processor(device: pyopencl.Device, misnamed: str) -> str | None:
    """Replace the name `misnamed` in PoCL's memory; the new name, or None where that cannot be done safely.

    Done once a device: its version keeps the old name after it.
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
    """Where pointers of the structure lead to the processor's name, in memory that may be written."""
    regions = _writable_regions()
    size = next((min(_DEVICE_BYTES, high - structure) for low, high in regions if low <= structure < high), 0)
    found = set()
    memory = os.open("/proc/self/mem", os.O_RDONLY)  # reading it fails where a bare pointer would end the process
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
