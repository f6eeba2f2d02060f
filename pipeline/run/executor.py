"""Where work is done: in this process, one piece after the other, or (in `cluster`) by dask's workers.

An executor knows nothing about stages. It takes functions and their subjects, passes on the events that they report,
and returns their results. Its caller decides what may start; the executor holds work back until there is room for it.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Protocol

from pipeline.events import Event
from pipeline.resources import Resources
from pipeline.run.process import KernelCache

Tell = Callable[[Event], None]
Work = Callable[[Any, Tell], Any]
"""A function at the top of a module; it takes its subject, and a function to which it reports events."""


@dataclass(frozen=True)
class Lost:
    """Stands in for a result that was lost, and says why. `transient`: a retry may succeed, as after a worker died."""

    reason: str
    transient: bool = False


class Executor(Protocol):
    """Runs pieces of work and returns their results."""

    def start(self, name: str, work: Work, subject: object, urgency: int, needs: Resources) -> None:
        """Queues `work(subject, tell)`, to run where there is what it `needs`; more urgent work is done first."""

    def wait(self, tell: Tell, seconds: float) -> tuple[str, Any] | None:
        """Passes on events until some work ends, and returns its name and result; None after so many seconds."""

    def close(self) -> None:
        """Ends everything, including work that is still running."""


class SerialExecutor:
    """Does the work in this process, during `wait`: for debugging, or if worker processes are too much.

    Does not check whether the machine has what a piece needs.
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
