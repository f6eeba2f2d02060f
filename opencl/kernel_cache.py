"""A directory of compiled kernels for each process: PoCL's must not be shared between processes that run at once."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, MutableMapping
from pathlib import Path

from filelock import FileLock, Timeout

_SLOTS = 64


def reserve_kernel_cache(environment: MutableMapping[str, str] = os.environ) -> FileLock | None:
    """Point `POCL_CACHE_DIR` at a directory that no other running process uses; keep the lock while kernels are used.

    Slots under the user's cache directory are taken in order, so that compiled kernels are found again by the next
    process. A `POCL_CACHE_DIR` that is set already is respected (None is returned). To be called before any platform
    is asked for.
    """
    if environment.get("POCL_CACHE_DIR"):
        return None
    for folder in (_in_users_cache, _for_this_process):
        try:
            return _reserve_slot(folder(environment), environment)
        except OSError:
            continue
    raise OSError("no directory for compiled kernels can be written; set POCL_CACHE_DIR to one")


def _in_users_cache(environment: Mapping[str, str]) -> Path:
    root = Path(environment.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "gs-hider" / "kernels"
    root.mkdir(parents=True, exist_ok=True)
    return root


def _for_this_process(environment: Mapping[str, str]) -> Path:
    return Path(tempfile.mkdtemp(prefix="gs-hider-kernels-"))


def _reserve_slot(root: Path, environment: MutableMapping[str, str]) -> FileLock:
    for slot in range(_SLOTS):
        lock = FileLock(root / f"{slot}.lock", timeout=0)
        try:
            lock.acquire()
        except Timeout:
            continue
        directory = root / str(slot)
        directory.mkdir(exist_ok=True)
        environment["POCL_CACHE_DIR"] = str(directory)
        return lock
    raise OSError(f"{root}: {_SLOTS} processes use OpenCL at once; set POCL_CACHE_DIR for each further one")
