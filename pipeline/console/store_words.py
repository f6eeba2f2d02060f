"""What `verify`, `gc` and `pins` print: lines for people, JSON for programs."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pipeline.console.tables import indented, table
from pipeline.console.wording import duration
from pipeline.disk import size_words
from pipeline.plain_text import in_a_line, without_controls
from pipeline.store.garbage import Collection as Garbage
from pipeline.store.pins import Pin
from pipeline.store.verification import Checked


class Verified:
    """Counts what `verify` has checked."""

    def __init__(self) -> None:
        self.numbers: Counter[str] = Counter()
        self._damaged: Counter[str] = Counter()
        self._is_any_irreplaceable = False
        self.size = 0
        self._started = time.monotonic()

    @property
    def damaged(self) -> int:
        """The number of damaged things, of any kind."""
        return self._damaged.total()

    @contextmanager
    def shown(self, artifacts: int, quiet: bool) -> Iterator[Callable[[Checked], None]]:
        """Yields a function that counts what was checked, and shows on a terminal how far of `artifacts` it is."""
        from rich.console import Console
        from rich.progress import Progress

        console = Console(stderr=True)
        with Progress(console=console, transient=True, disable=quiet or not console.is_terminal) as bar:
            task = bar.add_task("reading", total=artifacts)

            def count(checked: Checked) -> None:
                self.numbers[checked.what] += 1
                self._damaged[checked.what] += checked.damage is not None
                self._is_any_irreplaceable |= checked.irreplaceable
                self.size += checked.size
                bar.update(task, advance=checked.what == "artifact", description=f"read {size_words(self.size)}")

            yield count

    def words(self, dry_run: bool, damaged: Path) -> str:
        """The result on one line; `damaged` is the folder to which damaged data was moved."""
        found = f"{_counted(self.numbers) or 'nothing to check'}; {size_words(self.size)} read in {self._duration()}"
        if not self.damaged:
            return f"Everything is sound: {found}"
        exception = ", but not what cannot be made again" if self._is_any_irreplaceable else ""
        aside = f"moved to {damaged}; the next run remakes what it needs{exception}"
        remedy = "nothing was changed" if dry_run else aside
        return f"{_counted(+self._damaged)} damaged, of {found}; {remedy}"

    def as_json(self) -> dict[str, object]:
        """The result as `verify --json` prints it."""
        numbers = {f"{what}s": self.numbers[what] for what in ("artifact", "record", "pin", "link")}
        seconds = round(time.monotonic() - self._started, 3)
        return {"event": "summary", **numbers, "bytes": self.size, "damaged": self.damaged, "seconds": seconds}

    def _duration(self) -> str:
        return duration(time.monotonic() - self._started)


def _counted(numbers: Counter[str]) -> str:
    """How many there are of each kind; empty without any."""
    return ", ".join(f"{number} {what}{'s' * (number != 1)}" for what, number in numbers.items())


def verified_words(checked: Checked) -> str:
    """One damaged thing on one line."""
    name = checked.name[:12] if checked.what in ("artifact", "record") else checked.name
    stages = f" ({', '.join(checked.stages)})" if checked.stages else ""
    return without_controls(f"{checked.what} {name}{stages}: {checked.damage}")


def verified_as_json(checked: Checked) -> dict[str, object]:
    """One damaged thing as `verify --json` prints it."""
    return {
        "event": "damaged",
        "what": checked.what,
        "name": checked.name,
        "stages": list(checked.stages),
        "cause": checked.damage,
    }


def collection_words(garbage: Garbage, dry_run: bool) -> list[str]:
    """What is deleted, by workflow and stage, and what is kept and why, line by line."""
    rows = [
        [in_a_line(waste.workflow or waste.what), in_a_line(waste.stage), f"{waste.number}", size_words(waste.size)]
        for waste in garbage.waste
    ]
    verb = "Would delete" if dry_run else "Deleted"
    lines = [f"{verb}:", *indented(table(rows, right=(2, 3)))] if rows else []
    lines += ["Kept:", *(f"  {in_a_line(remark)}" for remark in garbage.remarks)] if garbage.remarks else []
    total = (
        f"{size_words(garbage.size)} {'would be' if dry_run else 'were'} freed"
        if rows
        else "There is nothing to delete"
    )
    return [*lines, f"{total}; {garbage.results_kept} results are kept."]


def collection_as_json(garbage: Garbage) -> list[str]:
    """What is deleted and what is kept, one JSON object per line."""
    objects: list[dict[str, object]] = [
        {
            "event": "waste",
            "what": waste.what,
            "workflow": waste.workflow or None,
            "stage": waste.stage or None,
            "number": waste.number,
            "bytes": waste.size,
        }
        for waste in garbage.waste
    ]
    objects += [{"event": "kept", "why": remark} for remark in garbage.remarks]
    objects.append({"event": "summary", "bytes": garbage.size, "results_kept": garbage.results_kept})
    return [json.dumps(content) for content in objects]


def pins_words(pins: Mapping[str, Pin], actions: Collection[str]) -> list[str]:
    """A line for each pin, with the number of its results that are in the store, if not all are."""
    rows = []
    for name, pin in pins.items():
        present = sum(key in actions for key in pin.keys.values())
        left = f" ({present} in the store)" if present < len(pin.keys) else ""
        facts = (in_a_line(pin.workflow), in_a_line(pin.made), f"{len(pin.keys)} results{left}")
        rows.append([without_controls(name), *facts])  # the whole name, which `unpin` takes
    return table(rows) or ["Nothing is pinned."]


def pin_as_json(name: str, pin: Pin, actions: Collection[str]) -> dict[str, object]:
    """A pin as `pins --json` prints it."""
    present = sum(key in actions for key in pin.keys.values())
    return {
        "event": "pin",
        "name": name,
        "workflow": pin.workflow,
        "made": pin.made,
        "results": len(pin.keys),
        "present": present,
    }
