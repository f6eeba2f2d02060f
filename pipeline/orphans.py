"""Processes that end with their parent, even if it was killed and they are deep in a library.

dask's workers and our companions watch a pipe that closes when their parent ends. But they watch it in Python, which
does not run while a library computes for minutes. The kernel does not have to wait for that.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of linux/prctl.h


def end_with_parent(parent: int) -> None:
    """Makes the kernel kill this process as soon as process `parent`, its parent, ends; does nothing but on Linux."""
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(SET_PARENT_DEATH_SIGNAL, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:  # it ended before the kernel was asked
        os._exit(1)
