"""What a process that runs stages needs before the first numeric library is loaded.

How many threads each library has, and who says so:

- torch: the parameter `threads` of a stage, since sums and so the bits depend on it;
- PoCL: all cores in every process, since no bit depends on it; `POCL_MAX_PTHREAD_COUNT` makes it fewer;
- pycolmap: features on all cores, matching and mapping on one, since more do not place the same photos twice;
- companions of a stage: a parameter of the stage; OpenCV and NumPy: as they were built.

So stages that run beside each other have more threads than there are cores, and that is well: measured on two cores
(`tests/benchmarks/two_trainings.py`), two trainings take 0.6 of the time together that they take one after the other,
because each leaves cores idle between its kernels. Two things keep it so: idle threads sleep, and no stage is held up
because another "uses all cores". A PoCL thread each, instead of two, made the two together 0 to 10 % faster, and would
leave half of the machine idle under one large training alone.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

THREADS: Mapping[str, str] = {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "0"}
"""Idle threads sleep, so that processes which may each use every core share the machine without a fight."""


def set_thread_policy() -> None:
    """Sets `THREADS` for this process and its children, except what the user has set."""
    for name, value in THREADS.items():
        os.environ.setdefault(name, value)


@contextmanager
def nobody_else_reads() -> Iterator[None]:
    """Files that this process and its children make meanwhile are for this user only, whatever makes them."""
    before = os.umask(0o077)
    try:
        yield
    finally:
        os.umask(before)


class KernelCache:
    """A folder of compiled OpenCL kernels that no other live process uses, kept from run to run.

    PoCL compiles for seconds at its first use, and two processes that write one cache can spoil it for each other: so
    each process takes the first folder that is free, and the kernel frees it when the process ends.
    """

    def __init__(self) -> None:
        try:
            self._take_one_in(_kernel_cache_parent())
        except OSError:  # no room left for this user, or no file locks, as on NFS without its lock manager
            self._take_one_in(_passing_folder())
        os.environ["POCL_CACHE_DIR"] = str(self.folder)

    def _take_one_in(self, parent: Path) -> None:
        number = 0
        while True:
            self.folder = parent / f"process-{number}"
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = FileLock(self.folder / ".lock", blocking=False)
            try:
                self._lock.acquire()
            except Timeout:
                number += 1
            else:
                break

    def release(self) -> None:
        self._lock.release()
        os.environ["POCL_CACHE_DIR"] = str(self.folder.parent)


def _kernel_cache_parent() -> Path:
    """Where PoCL was told to keep kernels, or the user's cache, or where that cannot be written a temporary folder."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    wished = Path(os.environ.get("POCL_CACHE_DIR") or home / "gs-hider" / "pocl")
    try:
        wished.mkdir(parents=True, exist_ok=True)
    except OSError:
        return _passing_folder()
    return wished if os.access(wished, os.W_OK) else _passing_folder()


def _passing_folder() -> Path:
    """A new folder that goes when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="gs-hider-pocl-"))
    atexit.register(_remove_own, folder, os.getpid())
    return folder


def _remove_own(folder: Path, process: int) -> None:
    if os.getpid() == process:  # a forked child owns nothing
        shutil.rmtree(folder, ignore_errors=True)
