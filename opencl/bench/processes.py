"""Measuring in a process of its own: nothing that ran before is in its memory, and nothing of it stays."""

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
    """What a module's function returns in a new process. `RuntimeError` where it raises or ends otherwise."""
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
    """Bytes: the most that this process has held so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def current_memory() -> int:
    """Bytes that this process holds now; where that is not told, the most so far."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return peak_memory()
    return pages * resource.getpagesize()
