"""A directory of compiled kernels for each process: PoCL's must not be shared between processes that run at once."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, MutableMapping
from pathlib import Path

from filelock import FileLock, Timeout

_SLOTS = 64
_USERS_CACHE = "XDG_CACHE_HOME"
_CACHE, _RESERVED = "POCL_CACHE_DIR", "GS_HIDER_KERNELS_OF"
"""Variables: PoCL's own, and beside it which process reserved that directory. A child inherits both."""


def reserve_kernel_cache(environment: MutableMapping[str, str] = os.environ) -> FileLock | None:
    """Point `POCL_CACHE_DIR` at a directory that no other running process uses; keep the lock while kernels are used.

    Slots under the user's cache directory are taken in order, so that compiled kernels are found again by the next
    process. A `POCL_CACHE_DIR` that is set already is respected (None is returned), unless another process reserved it
    for itself, the parent of this one. Where nothing can be written in the user's cache, `XDG_CACHE_HOME` names another
    folder from then on: pyopencl keeps there what it generates. To be called before any platform is asked for.
    """
    given = environment.get(_CACHE)
    if given and not _is_anothers(given, environment.get(_RESERVED, "")):
        return None
    for folder in (_in_users_cache, _for_this_process):
        try:
            return _reserve_slot(folder(environment), environment)
        except (OSError, RuntimeError):  # the latter where nobody says what the home directory is
            continue
    raise OSError("no directory for compiled kernels can be written; set POCL_CACHE_DIR to one")


def _is_anothers(directory: str, reserved: str) -> bool:
    """Whether what was noted in `_RESERVED` is that another process has this directory."""
    process, _, noted = reserved.partition(":")
    return noted == directory and process != str(os.getpid())


def _in_users_cache(environment: Mapping[str, str]) -> Path:
    root = Path(environment.get(_USERS_CACHE) or "~/.cache").expanduser() / "gs-hider" / "kernels"
    root.mkdir(parents=True, exist_ok=True)
    return root


def _for_this_process(environment: MutableMapping[str, str]) -> Path:
    folder = tempfile.mkdtemp(prefix="gs-hider-kernels-")
    environment[_USERS_CACHE] = folder
    return Path(folder)


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
