"""What a stage needs while it runs, and what a machine has: memory, and anything else that people count.

    resources={"gpu": 1, "memory": "8 GiB"}      in @stage(...)
    resources: {memory: 16 GiB}                  of a stage in a workflow file
    --resources "gpu=1 memory=64GiB"             what this machine has

Amounts are numbers. Memory is in bytes, and may be written with a unit. Amounts are not part of an action's key.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

from pipeline.errors import UserError

Resources = Mapping[str, float]

MEMORY = "memory"
UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
UNITS |= {"KIB": 2**10, "MIB": 2**20, "GIB": 2**30, "TIB": 2**40}
AMOUNT = re.compile(r"(\d+(?:\.\d*)?(?:[eE]\+?\d+)?)\s*([A-Za-z]*)")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
CONTROL_GROUPS = Path("/sys/fs/cgroup")


def amount(name: str, value: object) -> float:
    """The amount of a resource, given as a number or a text; bytes for memory.

    Raises UserError for a negative amount, anything else, or an invalid name.

    >>> amount("memory", "8 GiB"), amount("memory", "1.5e9"), amount("gpu", 1)
    (8589934592.0, 1500000000.0, 1.0)
    """
    if not NAME.fullmatch(name):
        raise UserError("cannot name a resource", found=repr(name), expected="letters, digits, '_' and '-'")
    unitless = isinstance(value, int | float) and not isinstance(value, bool)
    match = AMOUNT.fullmatch(str(value).strip()) if unitless or isinstance(value, str) else None
    unit = match.group(2).upper() if match else ""
    if match is None or unit not in (UNITS if name == MEMORY else ("",)):
        expected = "bytes, or a text such as 8 GiB" if name == MEMORY else "a number that is not negative"
        raise UserError(f"resource {name!r} has an invalid amount", found=repr(value), expected=expected)
    return float(match.group(1)) * UNITS[unit]


def amounts(given: Mapping[str, object]) -> dict[str, float]:
    """The amounts of several resources. Raises UserError if one is wrong."""
    return {name: amount(name, value) for name, value in given.items()}


def read_resources(text: str) -> dict[str, float]:
    """The resources in a text: `NAME=AMOUNT`, separated by blanks or commas. Raises UserError for any other text.

    >>> read_resources("gpu=1 memory=2GiB")
    {'gpu': 1.0, 'memory': 2147483648.0}
    """
    given: dict[str, object] = {}
    for item in text.replace(",", " ").split():
        name, equals, value = item.partition("=")
        if not equals:
            raise UserError("not a resource", found=repr(item), expected="NAME=AMOUNT, such as gpu=1 or memory=16GiB")
        given[name] = value
    return amounts(given)


def spelled(name: str, value: float) -> str:
    """An amount as a person reads it.

    >>> spelled("memory", 2.5 * 2**30), spelled("gpu", 1.0)
    ('2.5 GiB', '1')
    """
    if name != MEMORY:
        return f"{value:g}"
    unit = next((unit for unit in ("TiB", "GiB", "MiB", "KiB") if value >= UNITS[unit.upper()]), "B")
    return f"{value / UNITS[unit.upper()]:.4g} {unit}"


def resources_words(resources: Resources) -> str:
    """Resources as a person reads them; empty if there are none.
    >>> resources_words({"gpu": 1.0, "memory": 2.0**34})
    'gpu 1 and memory 16 GiB'
    """
    return " and ".join(f"{name} {spelled(name, value)}" for name, value in resources.items())


def memory_of_machine() -> float | None:
    """The most memory that this process may use, in bytes: the machine's, or less in a container; None if unknown."""
    try:
        found = [float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))]
    except (ValueError, OSError):
        return None
    for file in (CONTROL_GROUPS / "memory.max", CONTROL_GROUPS / "memory" / "memory.limit_in_bytes"):
        try:
            found.append(float(file.read_text()))
        except (OSError, ValueError):  # no such limit, or "max"
            continue
    return min(found)


def of_this_machine(stated: Resources) -> dict[str, float]:
    """What this machine has: its memory, unless `stated` says otherwise, and everything else in `stated`."""
    memory = memory_of_machine()
    return {**({MEMORY: memory} if memory else {}), **stated}
