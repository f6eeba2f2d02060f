"""NVIDIA's OpenCL where its driver is installed and the file that names it to the loader is not, as in containers."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LIBRARY = "libnvidia-opencl.so.1"
FOLDERS = (Path("/etc/OpenCL/vendors"), Path(sys.prefix) / "etc" / "OpenCL" / "vendors")
"""Where loaders look for ICD files, each of which names a library: the system's, and those of conda."""
VARIABLES = ("OCL_ICD_VENDORS", "OCL_ICD_FILENAMES")
"""By which whoever has other wishes tells a loader of them."""


@contextmanager
def nvidia_named() -> Iterator[None]:
    """While platforms are asked for: the loader, which looks once in a process, is told of NVIDIA's library, too.

    Nothing is done where the environment says what to load, where an installed ICD file names NVIDIA's, or where this
    machine has no such library. What is installed stays, and the environment is as it was afterwards.
    """
    if any(os.environ.get(name) for name in VARIABLES):
        yield
        return
    installed = [path for folder in FOLDERS for path in sorted(folder.glob("*.icd"))]
    if any("nvidia" in _text(path).lower() for path in installed) or not _is_here():
        yield
        return
    with tempfile.TemporaryDirectory(prefix="opencl-vendors-") as folder:
        for number, path in enumerate(installed):
            (Path(folder) / f"{number}.icd").write_text(_text(path))
        (Path(folder) / "nvidia.icd").write_text(LIBRARY + "\n")
        os.environ[VARIABLES[0]] = folder
        try:
            yield
        finally:
            del os.environ[VARIABLES[0]]


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""  # a loader that may not read it does without, too


def _is_here() -> bool:
    try:
        ctypes.CDLL(LIBRARY)
    except OSError:
        return False
    return True
