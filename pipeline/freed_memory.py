"""Memory that a stage frees is kept for what it asks for next, instead of going back to the kernel each time.

A training frees and asks for the same tensors in every iteration, some of them megabytes large. glibc hands such pieces
back, and each time they come again the kernel fills their pages with zeros: a tenth of a training's time
(`tests/benchmarks/training_iteration.py`). Other systems' allocators are left as they are.
"""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3
"""Parameters of glibc's mallopt, from malloc.h: how much may lie free at an arena's end, by how much more than asked
for it grows, and from which size on a piece is mapped by itself, to be unmapped when it is freed."""

LARGEST = 2**30
"""Bytes. Larger pieces go back as before."""
LARGEST_OF_OLDER_VERSIONS = 2**25
"""What glibc before 2.35 takes as MMAP_THRESHOLD at most."""
GROWTH = 2**26
"""Bytes; as large as the arena of a thread may be in one piece, so that none of these is given back between."""


def keep_freed_memory() -> None:
    """From now on, in this process. Tensors are as they were, bit for bit."""
    glibc = _glibc()
    if glibc is None:
        return
    if not glibc.mallopt(MMAP_THRESHOLD, LARGEST):
        glibc.mallopt(MMAP_THRESHOLD, LARGEST_OF_OLDER_VERSIONS)
    glibc.mallopt(TRIM_THRESHOLD, LARGEST)
    glibc.mallopt(TOP_PAD, GROWTH)


def return_freed_memory() -> None:
    """Gives back what is free now, for other processes: when a stage has ended."""
    glibc = _glibc()
    if glibc is not None:
        glibc.malloc_trim(0)


def _glibc() -> ctypes.CDLL | None:
    """The C library of this process, where it is glibc."""
    if sys.platform != "linux":
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "gnu_get_libc_version") else None
