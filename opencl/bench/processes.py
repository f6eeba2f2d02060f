"""Runs measurements in fresh processes, so that they do not affect each other's memory."""

from __future__ import annotations

import multiprocessing
import resource
import sys
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

Result = TypeVar("Result")


def in_fresh_process(function: Callable[..., Result], *arguments: Any) -> Result:
    """Run a module-level function in a new process. Raises RuntimeError if it fails or the process dies."""
    context = multiprocessing.get_context("spawn")  # a fork would hang OpenCL
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_answer, args=(there, function, *arguments))
    process.start()
    there.close()
    try:
        succeeded, answer = here.recv()
    except EOFError:
        process.join()
        raise RuntimeError(
            f"{function.__name__}: the process ended with exit status {process.exitcode}"
            + (", as happens where memory runs out" if process.exitcode == -9 else "")
        ) from None
    process.join()
    if not succeeded:
        raise RuntimeError(f"{function.__name__} failed in its process:\n{answer}")
    return answer


def _answer(connection: Connection, function: Callable[..., Any], *arguments: Any) -> None:
    try:
        answer = (True, function(*arguments))
    except Exception:
        answer = (False, traceback.format_exc())
    connection.send(answer)
    connection.close()


def peak_memory() -> int:
    """Peak resident memory of this process so far, in bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def current_memory() -> int:
    """Resident memory of this process in bytes, or its peak so far where the system does not report it."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return peak_memory()
    return pages * resource.getpagesize()
