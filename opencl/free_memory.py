"""The amount of memory that a process can still allocate, if the operating system reports it."""

from __future__ import annotations

from pathlib import Path

SYSTEM = Path("/proc/meminfo")
CONTROL_GROUP = Path("/sys/fs/cgroup")
"""The control group (version 2) that limits a container, as seen from inside."""


def free_memory() -> int | None:
    """Free and reclaimable bytes: the minimum of the machine's and the container's. None if both are unknown."""
    told = [amount for amount in (_of_system(), _of_control_group()) if amount is not None]
    return min(told, default=None)


def _of_system() -> int | None:
    for line in _text(SYSTEM).splitlines():
        name, _, amount = line.partition(":")
        if name == "MemAvailable":
            return 1024 * int(amount.split()[0])
    return None


def _of_control_group() -> int | None:
    most, used = (_text(CONTROL_GROUP / name).strip() for name in ("memory.max", "memory.current"))
    if not (most.isdigit() and used.isdigit()):
        return None
    return max(0, int(most) - int(used) + _files_kept())


def _files_kept() -> int:
    """Bytes of the page cache, which the operating system reclaims when memory runs short."""
    words = (line.split() for line in _text(CONTROL_GROUP / "memory.stat").splitlines())
    return sum(int(amount) for name, amount in words if name in ("active_file", "inactive_file"))


def _text(file: Path) -> str:
    try:
        return file.read_text()
    except OSError:
        return ""
