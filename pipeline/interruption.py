"""Signals that ask a run to stop."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def interruptible(ask: Callable[[], None]) -> Iterator[None]:
    """Calls `ask` at Ctrl-C, at SIGTERM, which cluster schedulers send ahead of SIGKILL, and at SIGHUP, when a terminal
    is closed; it may raise KeyboardInterrupt. Once asked, it is asked again by Ctrl-C alone: of one hangup a shell and
    the kernel tell, and `make` passes SIGTERM on. Outside the main thread nothing is interrupted."""
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
    """Whether a signal means something to this process: `nohup` has it ignore SIGHUP."""
    return signal.getsignal(number) is not signal.SIG_IGN
