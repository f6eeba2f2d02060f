"""Makes NVIDIA's OpenCL available if its driver is installed without the ICD file for the loader, as in containers."""

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
"""Folders in which the loaders of the system and of conda look for ICD files, each of which names a library."""
VARIABLES = ("OCL_ICD_VENDORS", "OCL_ICD_FILENAMES")
"""Environment variables by which users override what a loader loads."""


@contextmanager
def nvidia_named() -> Iterator[None]:
    """Let the OpenCL loader find NVIDIA's library in addition to the installed ones.

    Query the platforms within this context: the loader searches only once per process. Does nothing if the environment
    says what to load, if an installed ICD file names NVIDIA's library, or if the machine does not have it. Restores the
    environment afterwards.
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
        return ""  # a loader skips an unreadable file, too


def _is_here() -> bool:
    try:
        ctypes.CDLL(LIBRARY)
    except OSError:
        return False
    return True
