"""A stopwatch that always runs for exactly one part of the work, forward or backward.

    with watching(Stopwatch()) as stopwatch:
        with part("decoders"):
            pictures = decode(features)
        backward_of("decoders", pictures)
        loss(pictures).backward()       # counts as the decoders' from when the pictures' gradients are complete
    print(stopwatch.table(iterations=1))

Autograd works through an iteration in the reverse order of its forward pass, so that one mark where a part's results
are made says when its backward pass begins. torch's own profiler would need no marks, but it records thousands of
events an iteration: a fifth of the time while it runs and seconds to read it. This costs microseconds and can stay on.
On a GPU, which works off what torch queues, a part's time is that of queueing, and of waiting where a number is read.
It computes nothing, so that no bit of a result depends on it. Where no stopwatch runs, parts and marks do nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from typing import Literal

from torch import Tensor

Direction = Literal["forward", "backward"]
OTHER = "other"

_running: ContextVar[Stopwatch | None] = ContextVar("running stopwatch", default=None)


class Stopwatch:
    """Seconds of every (part, direction) since it was made, by `clock`; what belongs to no part is `OTHER`."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: dict[tuple[str, Direction], float] = {}
        self._clock = clock
        self._current: tuple[str, Direction] = (OTHER, "forward")
        self._since = clock()

    def switch(self, name: str, direction: Direction = "forward") -> tuple[str, Direction]:
        """End the current part and begin another; returns the one that ended."""
        now, ended = self._clock(), self._current
        self.seconds[ended] = self.seconds.get(ended, 0.0) + now - self._since
        self._current, self._since = (name, direction), now
        return ended

    @property
    def total(self) -> float:
        """All seconds, up to now."""
        self.switch(*self._current)
        return sum(self.seconds.values())

    def reading(self) -> list[tuple[str, Direction, float]]:
        """Part, direction and seconds of each, up to now."""
        self.switch(*self._current)
        return [(name, direction, seconds) for (name, direction), seconds in self.seconds.items()]

    def add(self, reading: Iterable[tuple[str, Direction, float]]) -> None:
        """Count what another stopwatch read, too: the seconds of work that this one goes on with."""
        for name, direction, seconds in reading:
            self.seconds[name, direction] = self.seconds.get((name, direction), 0.0) + seconds

    def table(self, iterations: int) -> str:
        """A line a part, the longest first: milliseconds an iteration, forward and backward, and the share in all."""
        total = self.total
        parts: dict[str, float] = {}
        for (name, _), seconds in self.seconds.items():
            parts[name] = parts.get(name, 0.0) + seconds
        lines = [f"{1e3 * total / iterations:.1f} ms an iteration, mean of {iterations}"]
        for name, seconds in sorted(parts.items(), key=lambda item: -item[1]):
            forward, backward = (
                1e3 * self.seconds.get((name, direction), 0.0) / iterations for direction in ("forward", "backward")
            )
            lines.append(
                f"  {name:20} {100 * seconds / total:5.1f} %  forward {forward:7.2f} ms  backward {backward:7.2f} ms"
            )
        return "\n".join(lines)


@contextmanager
def watching(stopwatch: Stopwatch) -> Iterator[Stopwatch]:
    """Inside, parts and marks of this thread are measured by this stopwatch."""
    token = _running.set(stopwatch)
    try:
        yield stopwatch
    finally:
        _running.reset(token)


@contextmanager
def part(name: str, direction: Direction = "forward") -> Iterator[None]:
    """The time inside belongs to this part, except for parts within it and for marks that backward passes."""
    stopwatch = _running.get()
    if stopwatch is None:
        yield
        return
    outer = stopwatch.switch(name, direction)
    try:
        yield
    finally:
        stopwatch.switch(*outer)


def backward_of(name: str, *results: Tensor) -> None:
    """Once the gradient of one of a part's results is complete, backward is within this part."""
    stopwatch = _running.get()
    if stopwatch is None:
        return
    for result in results:
        if result.requires_grad:
            result.register_hook(partial(_enter, stopwatch, name))


def _enter(stopwatch: Stopwatch, name: str, _: Tensor) -> None:
    """Returns nothing: what a hook returns replaces the gradient."""
    stopwatch.switch(name, "backward")
