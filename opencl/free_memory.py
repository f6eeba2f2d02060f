"""How much memory a process may still take, where the operating system says so."""

from __future__ import annotations

from pathlib import Path

SYSTEM = Path("/proc/meminfo")
CONTROL_GROUP = Path("/sys/fs/cgroup")
"""Of a container its own: what limits it."""


def free_memory() -> int | None:
    """Bytes that are free or can be freed, of the machine and of its container; None where neither is told."""
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
    """Bytes of files that are kept in memory for later, and let go where room is needed."""
    words = (line.split() for line in _text(CONTROL_GROUP / "memory.stat").splitlines())
    return sum(int(amount) for name, amount in words if name in ("active_file", "inactive_file"))


def _text(file: Path) -> str:
    try:
        return file.read_text()
    except OSError:
        return ""
