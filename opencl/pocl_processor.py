"""PoCL from PyPI on processors that are younger than it: tell it which one to compile for.

PoCL 3.0, the newest on PyPI, asks its LLVM 14 for the processor's name. For one that LLVM does not know (AMD Zen 5,
say) the answer is "generic", which clang then refuses, so that no kernel builds at all: "unknown target CPU 'generic'"
(github.com/pocl/pocl/issues/1049). There is no setting for it. The name is a string in PoCL's description of the
device; it is replaced there, in this process only, by the closest processor that LLVM 14 knows.
"""

from __future__ import annotations

import ctypes
import functools
import os
import platform
import struct
from pathlib import Path

import pyopencl

_UNKNOWN = b"generic\0"
_DEVICE_BYTES = 2048
"""Of PoCL's device structure, which is shorter; what lies behind it may hold stale copies of the same pointer."""


def lacks_processor(device: pyopencl.Device) -> bool:
    """Whether this is a PoCL device whose LLVM does not know the processor."""
    return device.platform.name == "Portable Computing Language" and device.version.rstrip().endswith("-generic")


def closest_known_processor(flags: set[str]) -> str:
    """The best x86 processor in LLVM 14's list whose instructions are all among `flags` (those of /proc/cpuinfo).

    At most seven letters: the name takes the place of "generic". `skx` is Skylake's server core, with AVX-512.

    >>> closest_known_processor({"sse2"})
    'x86-64'
    """
    haswell = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm", "popcnt", "rdrand", "fsgsbase"}
    skylake = haswell | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "adx", "aes", "clwb", "pclmulqdq"}
    if skylake <= flags:
        return "skx"
    return "haswell" if haswell <= flags else "x86-64"


@functools.cache
def name_processor(device: pyopencl.Device) -> str | None:
    """Replace the unknown processor's name in PoCL's memory; the new name, or None where that cannot be done safely.

    Done once a device: its version keeps saying "generic" after it.
    """
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        return None
    name = closest_known_processor(_processor_flags())
    addresses = _addresses_of_name(device.int_ptr)
    if len(addresses) != 1:
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


def _addresses_of_name(structure: int) -> set[int]:
    """Where pointers of the structure lead to the unknown processor's name, in memory that may be written."""
    regions = _writable_regions()
    size = next((min(_DEVICE_BYTES, high - structure) for low, high in regions if low <= structure < high), 0)
    found = set()
    memory = os.open("/proc/self/mem", os.O_RDONLY)  # reading it fails where a bare pointer would end the process
    try:
        for (pointer,) in struct.iter_unpack("P", os.pread(memory, size // 8 * 8, structure)):
            inside = any(low <= pointer and pointer + len(_UNKNOWN) <= high for low, high in regions)
            if inside and os.pread(memory, len(_UNKNOWN), pointer) == _UNKNOWN:
                found.add(pointer)
    except OSError:
        return set()
    finally:
        os.close(memory)
    return found
