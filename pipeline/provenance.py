"""Facts recorded with a result, but never in its key: what it was made with, where and from which commit."""

from __future__ import annotations

import functools
import importlib.metadata
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path


def now() -> str:
    """The time in UTC, in ISO format, to the millisecond, so that results made within one second have an order."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def versions_of(libraries: Iterable[str]) -> dict[str, str]:
    """Versions of Python and of the distributions that the top-level modules `libraries` come from."""
    versions = {"python": platform.python_version()}
    for library in libraries:
        if library in sys.stdlib_module_names:
            continue
        try:
            versions[library] = importlib.metadata.version(library)
        except importlib.metadata.PackageNotFoundError:  # Pillow, for one, is imported as PIL
            versions |= {name: importlib.metadata.version(name) for name in providers().get(library, ())}
    return dict(sorted(versions.items()))


@functools.cache
def providers() -> Mapping[str, list[str]]:
    """The distributions that provide each top-level module. Slow, so computed once per process."""
    return importlib.metadata.packages_distributions()


def machine() -> dict[str, str | int]:
    """The machine that this process runs on."""
    return {
        "host": platform.node(),
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def git_commit(folder: Path) -> str | None:
    """The commit of the work tree that holds `folder`, with `+` if tracked files are modified; None without git."""
    try:
        answers = [
            subprocess.run(
                ["git", "-C", str(folder), *command], capture_output=True, text=True, timeout=10, check=True
            ).stdout.strip()
            for command in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])
        ]
    except (OSError, subprocess.SubprocessError):
        return None
    return answers[0] + ("+" if answers[1] else "")
