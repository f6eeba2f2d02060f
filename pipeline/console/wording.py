"""Events in words, and how long a running stage will still take."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from pipeline.events import Remarked, StageEnded, StageProgressed, StageState, Summary

RECENT = 60.0  # seconds over which a pace is measured


class Pace:
    """How fast a stage proceeds, over the last minute: one that resumed half-way did not do the first half just now."""

    def __init__(self) -> None:
        self._marks: deque[tuple[float, float]] = deque()

    def note(self, moment: float, done: float) -> None:
        """Records how much was done at a moment, in seconds; starts over if `done` goes backwards."""
        if self._marks and done < self._marks[-1][1]:
            self._marks.clear()
        while len(self._marks) > 1 and moment - self._marks[1][0] >= RECENT:
            self._marks.popleft()
        self._marks.append((moment, done))

    def left(self, total: float) -> float | None:
        """Seconds until `total` is done at this pace; None if that cannot be estimated.

        >>> pace = Pace()
        >>> pace.note(0.0, 600); pace.note(10.0, 700)
        >>> pace.left(1200)
        50.0
        """
        if len(self._marks) < 2:
            return None
        (began, first), (ended, last) = self._marks[0], self._marks[-1]
        if last <= first or ended <= began or total < last:
            return None
        return (total - last) * (ended - began) / (last - first)


def ending(event: StageEnded) -> str:
    """How a stage ended, on one line.

    >>> ending(StageEnded("cover", "ran", "5e", 12.34, {}))
    'cover: done in 12.3 s'
    """
    if event.state == "ran":
        return f"{event.name}: done in {duration(event.seconds)}"
    if event.state == "cached":
        return f"{event.name}: cached"
    log = f" (log: {event.log})" if event.state == "failed" and event.log else ""
    return f"{event.name}: {event.state}: {event.cause}{log}"


def remark_words(event: Remarked) -> str:
    """A remark, and where to read more.
    >>> remark_words(Remarked("cover", "15 of 25 photos placed"))
    'cover: 15 of 25 photos placed'
    """
    return f"{event.name}: {event.text}" + (f" (log: {event.log})" if event.log else "")


def summary_words(workflow: str, summary: Summary) -> str:
    """The end of a run on one line.

    >>> summary_words("hide", Summary(4.2, {"ran": 3, "cached": 11}))
    'hide: 3 ran, 11 cached in 4.2 s'
    """
    states: tuple[StageState, ...] = ("ran", "cached", "failed", "skipped")
    counted = [f"{summary.counts[state]} {state}" for state in states if summary.counts.get(state)]
    return f"{workflow}: {', '.join(counted) or 'nothing to do'} in {duration(summary.seconds)}"


def progress_words(event: StageProgressed, left: float | None) -> str:
    """How far a stage is, in words; `left` is how many seconds it will still take, if known.

    >>> progress_words(StageProgressed("hide", 300, 1200, {"psnr": 22.125}), 180.0)
    '25 % (300 of 1200), 3 min left, psnr 22.12'
    """
    parts = [f"{event.done:g} of {event.total:g}"]
    if event.total:
        parts = [f"{100 * event.done / event.total:.0f} % ({event.done:g} of {event.total:g})"]
    if left is not None:
        parts.append(f"{duration(left)} left")
    return ", ".join([*parts, *([figures_words(event.figures)] if event.figures else [])])


def figures_words(figures: Mapping[str, float]) -> str:
    """Current figures on one line; empty if there are none.
    >>> figures_words({"psnr": 22.1234, "splats": 31000})
    'psnr 22.12, splats 31,000'
    """
    return ", ".join(f"{name} {value:{'.4g' if abs(value) < 1000 else ',.0f'}}" for name, value in figures.items())


def duration(seconds: float) -> str:
    """A duration in words.
    >>> duration(0.04), duration(75), duration(180), duration(4000)
    ('0.0 s', '1 min 15 s', '3 min', '1 h 6 min')
    """
    if seconds < 60:
        return f"{seconds:.1f} s"
    large, small, names = (*divmod(round(seconds), 60), ("min", "s"))
    if large >= 60:
        large, small, names = (*divmod(large, 60), ("h", "min"))
    return f"{large} {names[0]}" + (f" {small} {names[1]}" if small else "")


def clock_words(seconds: float) -> str:
    """A duration as a clock shows it.
    >>> clock_words(7), clock_words(75), clock_words(4000)
    ('0:07', '1:15', '1:06:40')
    """
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute}:{second:02}"
