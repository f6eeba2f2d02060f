"""Caches what a process does once, whichever of its threads comes first."""

from __future__ import annotations

import functools
from collections.abc import Callable
from threading import RLock
from typing import TypeVar

Result = TypeVar("Result")

_LOCK = RLock()
"""One for all: what is done once calls other things that are done once."""


def once(function: Callable[..., Result]) -> Callable[..., Result]:
    """`functools.cache`, but threads that call at the same time wait for the first one's result.

    `functools.cache` alone would let each of them compute its own.
    """
    cached = functools.cache(function)

    @functools.wraps(function)
    def locked(*arguments: object) -> Result:
        with _LOCK:
            return cached(*arguments)

    return locked
