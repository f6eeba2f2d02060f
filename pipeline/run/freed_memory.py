"""Keeps memory that a stage frees for its next allocation, instead of returning it to the kernel each time.

A training frees and allocates the same tensors in every iteration, some of them megabytes large. glibc returns such
blocks, and each time they come back the kernel fills their pages with zeros: a tenth of a training's time
(`tests/benchmarks/training_iteration.py`). Other systems' allocators are left as they are.
"""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3
"""Parameters of glibc's mallopt, from malloc.h: how much may be free at an arena's end, by how much more than asked
for it grows, and from which size on a block is mapped separately, to be unmapped when it is freed."""

LARGEST = 2**30
"""Bytes. Larger blocks are returned as before."""
LARGEST_OF_OLDER_VERSIONS = 2**25
"""Bytes; the largest MMAP_THRESHOLD that glibc before 2.35 accepts."""
GROWTH = 2**26
"""Bytes; as large as a contiguous part of a thread's arena can be, so that none of these is returned in between."""


def keep_freed_memory() -> None:
    """Takes effect in this process, from now on; without glibc it does nothing. Tensors stay the same, bit for bit."""
    glibc = _glibc()
    if glibc is None:
        return
    if not glibc.mallopt(MMAP_THRESHOLD, LARGEST):
        glibc.mallopt(MMAP_THRESHOLD, LARGEST_OF_OLDER_VERSIONS)
    glibc.mallopt(TRIM_THRESHOLD, LARGEST)
    glibc.mallopt(TOP_PAD, GROWTH)


def return_freed_memory() -> None:
    """Returns unused memory for other processes; to be called when a stage has ended."""
    glibc = _glibc()
    if glibc is not None:
        glibc.malloc_trim(0)


def _glibc() -> ctypes.CDLL | None:
    """The C library of this process if it is glibc, else None."""
    if sys.platform != "linux":
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "gnu_get_libc_version") else None
