"""Processes that end when the process does that started them, even if it was killed and they are deep in a library.

dask's workers and our companions watch a pipe that closes with their parent. But what watches is Python, which waits
while a library computes for minutes: the kernel does not wait.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of linux/prctl.h


def end_with_parent(parent: int) -> None:
    """Has the kernel end this process as soon as process `parent` ends; without effect on other systems than Linux."""
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(SET_PARENT_DEATH_SIGNAL, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:  # it ended before the kernel was asked
        os._exit(1)
