"""Where work is done: in this process, one piece after the other, or (in `cluster`) by dask's workers.

An executor knows nothing of stages. It is given functions and what they work on, passes on the events that they tell,
and says what came out. Whoever gives it the work decides what may start; the executor holds it until there is room.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Protocol

from pipeline.events import Event
from pipeline.process import KernelCache
from pipeline.resources import Resources

Tell = Callable[[Event], None]
Work = Callable[[Any, Tell], Any]
"""A function at the top of a module: it is given what it works on, and where to tell events."""


@dataclass(frozen=True)
class Lost:
    """Instead of a result: why there is none. `transient` where it may be another time, as when a worker died."""

    reason: str
    transient: bool = False


class Executor(Protocol):
    def start(self, name: str, work: Work, subject: object, urgency: int, needs: Resources) -> None:
        """Has `work(subject, tell)` done where there is what it needs. What is more urgent is done first."""

    def wait(self, tell: Tell, seconds: float) -> tuple[str, Any] | None:
        """Passes on events until some work ends, and returns its name and result; None if that takes longer."""

    def close(self) -> None:
        """Ends everything, work that still runs included."""


class SerialExecutor:
    """Does the work in this process when it is waited for: for debugging, and where processes are too much.

    Whether the machine has what a piece needs is not asked.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[int, str, Work, object]] = []
        self._kernel_cache = KernelCache()

    def start(self, name: str, work: Work, subject: object, urgency: int, needs: Resources) -> None:
        bisect.insort(self._waiting, (-urgency, name, work, subject), key=itemgetter(0))

    def wait(self, tell: Tell, seconds: float) -> tuple[str, Any] | None:
        if not self._waiting:
            return None
        _, name, work, subject = self._waiting.pop(0)
        return name, work(subject, tell)

    def close(self) -> None:
        self._waiting.clear()
        self._kernel_cache.release()
