"""A kernel cache directory for each process, as concurrent processes must not share PoCL's."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Mapping, MutableMapping
from pathlib import Path

from filelock import FileLock, Timeout

_SLOTS = 64
_USERS_CACHE = "XDG_CACHE_HOME"
_CACHE, _RESERVED = "POCL_CACHE_DIR", "GS_HIDER_KERNELS_OF"
"""Environment variables: PoCL's own, and the process that reserved its directory. Child processes inherit both."""


def reserve_kernel_cache(environment: MutableMapping[str, str] = os.environ) -> FileLock | None:
    """Point `POCL_CACHE_DIR` at a directory that no other running process uses. Hold the lock while kernels are used.

    Call this before the first query for OpenCL platforms. Slots in the user's cache directory are taken in order, so
    that the next process finds the compiled kernels again. If `POCL_CACHE_DIR` is already set, it is left alone and
    None is returned, unless it was inherited from a parent process that had reserved it for itself. If no slot in the
    user's cache is usable, a temporary directory is used until this process ends, and `XDG_CACHE_HOME` names it from
    then on, because pyopencl stores generated files there. Raises OSError if no directory can be used.
    """
    given = environment.get(_CACHE)
    if given and not _is_anothers(given, environment.get(_RESERVED, "")):
        return None
    for folder in (_in_users_cache, _for_this_process):
        try:
            return _reserve_slot(folder(environment), environment)
        except (OSError, RuntimeError):  # RuntimeError if the home directory is unknown
            continue
    raise OSError("no directory for compiled kernels can be written; set POCL_CACHE_DIR to one")


def _is_anothers(directory: str, reserved: str) -> bool:
    """Whether `reserved`, the value of `_RESERVED`, says that another process has reserved this directory."""
    process, _, noted = reserved.partition(":")
    return noted == directory and process != str(os.getpid())


def _in_users_cache(environment: Mapping[str, str]) -> Path:
    root = Path(environment.get(_USERS_CACHE) or "~/.cache").expanduser() / "gs-hider" / "kernels"
    root.mkdir(parents=True, exist_ok=True)
    return root


def _for_this_process(environment: MutableMapping[str, str]) -> Path:
    folder = tempfile.mkdtemp(prefix="gs-hider-kernels-")
    atexit.register(_remove_own, folder, os.getpid())
    environment[_USERS_CACHE] = folder
    return Path(folder)


def _remove_own(folder: str, process: int) -> None:
    if os.getpid() == process:  # a forked child owns nothing
        shutil.rmtree(folder, ignore_errors=True)


def _reserve_slot(root: Path, environment: MutableMapping[str, str]) -> FileLock:
    for slot in range(_SLOTS):
        lock = FileLock(root / f"{slot}.lock", timeout=0)
        try:
            lock.acquire()
        except Timeout:
            continue
        directory = root / str(slot)
        directory.mkdir(exist_ok=True)
        environment[_CACHE], environment[_RESERVED] = str(directory), f"{os.getpid()}:{directory}"
        return lock
    raise OSError(f"{root}: {_SLOTS} processes use OpenCL at once; set POCL_CACHE_DIR for each further one")
