"""What a process that runs stages needs before it loads the first numerical library.

How many threads each library uses, and what determines the number:

- torch: the stage's parameter `threads`, since sums, and so the bits of results, depend on it;
- PoCL: all cores in every process, since no bit depends on it; `POCL_MAX_PTHREAD_COUNT` limits it;
- pycolmap: all cores for features, one for matching and mapping, since more do not place the same photos every time;
- companions of a stage: a parameter of the stage; OpenCV and NumPy: their built-in defaults.

So stages that run side by side have more threads than there are cores. This is intended: measured on two cores
(`tests/benchmarks/two_trainings.py`), two trainings at once take 0.6 of the time that they take one after the other,
because each leaves cores idle between its kernels. Two things make this work: idle threads sleep, and no stage waits
because another "uses all cores". One PoCL thread each, instead of two, made the pair 0 to 10 % faster, but would leave
half of the machine idle during one large training alone.
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
"""Idle threads sleep, so that processes that may each use every core share the machine without contention."""


def set_thread_policy() -> None:
    """Sets `THREADS` for this process and its children, except variables that the user has set."""
    for name, value in THREADS.items():
        os.environ.setdefault(name, value)


@contextmanager
def nobody_else_reads() -> Iterator[None]:
    """Within the block, files created by this process and its children are for this user only."""
    before = os.umask(0o077)
    try:
        yield
    finally:
        os.umask(before)


class KernelCache:
    """A folder of compiled OpenCL kernels that no other live process uses, kept from run to run.

    PoCL compiles for seconds on first use, and two processes that write to one cache can corrupt it for each other. So
    each process takes the first free folder, which the operating system frees when the process ends.
    """

    def __init__(self) -> None:
        self._before = os.environ.get("POCL_CACHE_DIR")
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
        """Frees the folder, and leaves `POCL_CACHE_DIR` as it was: what it names is for this process alone."""
        self._lock.release()
        if self._before is None:
            os.environ.pop("POCL_CACHE_DIR", None)
        else:
            os.environ["POCL_CACHE_DIR"] = self._before


def _kernel_cache_parent() -> Path:
    """`POCL_CACHE_DIR`, or else a folder in the user's cache; a temporary one if that cannot be written."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    wished = Path(os.environ.get("POCL_CACHE_DIR") or home / "gs-hider" / "pocl")
    try:
        wished.mkdir(parents=True, exist_ok=True)
    except OSError:
        return _passing_folder()
    return wished if os.access(wished, os.W_OK) else _passing_folder()


def _passing_folder() -> Path:
    """A new folder that is deleted when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="gs-hider-pocl-"))
    atexit.register(_remove_own, folder, os.getpid())
    return folder


def _remove_own(folder: Path, process: int) -> None:
    if os.getpid() == process:  # a forked child owns nothing
        shutil.rmtree(folder, ignore_errors=True)
