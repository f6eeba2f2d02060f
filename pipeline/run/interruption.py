"""Signals that ask a run to stop."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def interruptible(ask: Callable[[], None]) -> Iterator[None]:
    """Calls `ask` on Ctrl-C, on SIGTERM and on SIGHUP; `ask` may raise KeyboardInterrupt.

    Cluster schedulers send SIGTERM before SIGKILL, and a closed terminal sends SIGHUP. After the first call, only
    Ctrl-C calls it again: a shell and the kernel both report one hangup, and `make` passes SIGTERM on. Outside the main
    thread, signals are left as they are.
    """
    asked_before = False

    def asked(number: int, frame: FrameType | None) -> None:
        nonlocal asked_before
        again, asked_before = asked_before, True
        if not again or number == signal.SIGINT:
            ask()

    try:
        before = {number: signal.signal(number, asked) for number in STOPPING if heeded(number)}
    except ValueError:  # not the main thread
        before = {}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def heeded(number: signal.Signals) -> bool:
    """Whether this process reacts to a signal: under `nohup` it ignores SIGHUP."""
    return signal.getsignal(number) is not signal.SIG_IGN
