"""Checkpoints: what a stage saves to resume after an interruption, in a private directory for each action.

    checkpoints = Checkpoints(context, libraries=("torch",))
    found = checkpoints.newest()
    if found is not None:
        go_on_from(found.state)
    while work_is_left():
        work()
        checkpoints.save_or_stop(state, "stopped after step 3")

A checkpoint is an artifact, `checkpoint-N` in the scratch directory. It is written aside, flushed and renamed, and only
then is the previous one deleted. It belongs to the key of its action, so a changed parameter never meets it.
"""

from __future__ import annotations

import math
import os
import shutil
import time
import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.artifact import Artifact, ArtifactWriter, load, publish
from pipeline.canonical import Json
from pipeline.errors import CorruptArtifact, Interrupted, UserError
from pipeline.provenance import versions_of
from pipeline.stage import Context
from pipeline.store.store import Store

if TYPE_CHECKING:
    import numpy as np

FORMAT = 1
EVERY = 60.0  # seconds: the most that a kill costs, if a checkpoint takes less than 0.6 s
LARGEST_SHARE = 0.01  # of the time spent on checkpoints: one that takes 2 s is due every 200 s; up to `LONGEST`
LONGEST = 600.0  # seconds: a disk that stalls once must not delay the next checkpoint by an hour
EVERY_VARIABLE = "GS_HIDER_CHECKPOINT_SECONDS"
"""Environment variable: seconds between two checkpoints, whatever they cost; 0 for one at every chance."""

LARGEST_CHUNK = 1 << 24  # items: large chunks mean few files, each of which costs a flush


def scratch_directory(store: Store, key: str) -> Path:
    """The scratch directory of an action, new or as an interrupted run left it; nobody else can read it."""
    store.folder("scratch")
    path = store.root / "scratch" / key
    path.mkdir(mode=0o700, exist_ok=True)
    return path


def discard_scratch(store: Store, key: str) -> None:
    """Deletes the scratch directory of an action that is committed and needs no checkpoint any more."""
    shutil.rmtree(store.root / "scratch" / key, ignore_errors=True)


@dataclass(frozen=True)
class State:
    """Everything that a stage needs to resume: arrays of numbers or booleans, and JSON values, each by name."""

    arrays: Mapping[str, np.ndarray]
    values: Mapping[str, Json]


@dataclass(frozen=True)
class Checkpoint:
    """What was saved, and when, in local time."""

    written: str
    state: State


class Checkpoints:
    """The checkpoints of one action. They are private, whatever the stage's outputs are.

    The result depends on the versions of `libraries` and on `circumstances`, such as the device. A checkpoint written
    with another version or device is used all the same, and the stage's log says so. `every` is the number of seconds
    between two checkpoints, whatever they cost. By default `EVERY_VARIABLE` decides; without it 60 s, or more if
    checkpoints would otherwise take over a hundredth of the time, but at most ten minutes. Raises UserError if that
    variable is not a number.
    """

    def __init__(
        self,
        context: Context,
        libraries: Iterable[str] = (),
        circumstances: Mapping[str, str] | None = None,
        every: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._context = context
        self._folder = context.scratch
        self._log = context.log
        self._made_with = versions_of(libraries) | dict(circumstances or {})
        self._every = every if every is not None else wished_seconds()
        self._clock = clock
        self._began = clock()
        self._due_at = clock() + (EVERY if self._every is None else self._every)

    def newest(self) -> Checkpoint | None:
        """The latest sound checkpoint, every byte of it checked; None if there is none. The log names damaged ones.

        The time that it took to get there counts as the stage's time, too.
        """
        for path in reversed(self._complete()):
            try:
                return self._read(path)
            except (CorruptArtifact, OSError, LookupError, TypeError, ValueError) as error:
                self._log(f"{path.name} cannot be used: {error}")
        return None

    def due(self) -> bool:
        """Whether it is time to save another checkpoint."""
        return self._clock() >= self._due_at

    def save_or_stop(self, state: Callable[[], State], stopped: str) -> None:
        """For every step of a loop: saves its state when that is due, and also when the stage should stop.

        In the latter case it raises Interrupted afterwards, with `stopped`, which says where the work stopped.
        """
        stops = self._context.stop_requested()
        if stops or self.due():
            self.save(state())
        if stops:
            raise Interrupted(stopped)

    def save(self, state: State) -> None:
        """Replaces the previous checkpoint, atomically and durably.

        If the disk does not take it, the log and the run say so, the previous one stays, and work can go on.
        """
        began = self._clock()
        aside = self._folder / f".checkpoint-{uuid.uuid4().hex}"
        before = [*self._complete(), *self._folder.glob(".checkpoint-*")]
        problem = None
        try:
            self._write(aside, state)
        except OSError as error:
            self._log(f"the checkpoint could not be written: {error}")
            problem = error.strerror or str(error)
            before = [aside]
        for path in before:
            shutil.rmtree(path, ignore_errors=True)
        self._context.saved(problem)
        now = self._clock()
        self._due_at = now + self._pause(now - began)

    def _pause(self, cost: float) -> float:
        if self._every is not None:
            return self._every
        return min(max(EVERY, cost / LARGEST_SHARE), LONGEST)

    def _complete(self) -> list[Path]:
        """The checkpoints that were renamed into place, oldest first; usually one."""
        numbered = [path for path in self._folder.glob("checkpoint-*") if path.name.partition("-")[2].isdecimal()]
        return sorted(numbered, key=_number)

    def _write(self, aside: Path, state: State) -> None:
        last = max(map(_number, self._complete()), default=0)
        writer = ArtifactWriter(aside, "checkpoint", private=True)
        writer.attributes.update(
            format=FORMAT,
            written=datetime.now().astimezone().isoformat(" ", "seconds"),
            made_with=dict(self._made_with),
            values=dict(state.values),
            seconds=self._context.seconds_before + self._clock() - self._began,
            table=_write_packed(writer, state.arrays),
        )
        publish(writer.finish(), self._folder / f"checkpoint-{last + 1}")

    def _read(self, path: Path) -> Checkpoint:
        artifact = load(path)
        attributes: Mapping[str, Any] = artifact.attributes
        if attributes["format"] != FORMAT:
            raise ValueError(f"its format is {attributes['format']}; this program reads {FORMAT}")
        checkpoint = Checkpoint(attributes["written"], State(_read_packed(artifact), attributes["values"]))
        self._compare(attributes["made_with"])
        self._context.worked_before(attributes.get("seconds", 0.0))
        return checkpoint

    def _compare(self, made_with: Mapping[str, str]) -> None:
        others = [
            f"{name} {made_with.get(name, 'unknown')}, now {self._made_with.get(name, 'unknown')}"
            for name in sorted({*made_with, *self._made_with})
            if made_with.get(name) != self._made_with.get(name)
        ]
        if others:
            self._log(f"the checkpoint was written with {'; '.join(others)}: the result may differ in its last bits")


def _number(path: Path) -> int:
    return int(path.name.partition("-")[2])


def wished_seconds() -> float | None:
    """The value of `EVERY_VARIABLE`, None if it is not set. Raises UserError if it is not a number of seconds."""
    text = os.environ.get(EVERY_VARIABLE)
    if not text:
        return None
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not seconds >= 0:
        raise UserError(
            "not a number of seconds",
            where=EVERY_VARIABLE,
            found=text,
            expected="a number such as 600, or 0 for a checkpoint at every opportunity",
            remedy=f"Unset it to write one about every {EVERY:.0f} seconds.",
        )
    return seconds


def _write_packed(writer: ArtifactWriter, arrays: Mapping[str, np.ndarray]) -> list[Json]:
    """Writes all arrays of one type as a single array, and returns a table of name, type and shape of each, in order.

    A zarr array is four files and folders, each of which is flushed: 75 arrays took five times as long as one.
    """
    import numpy as np

    table: list[Json] = []
    groups: dict[str, list[np.ndarray]] = {}
    for name, array in arrays.items():
        kind = array.dtype.name
        table.append([name, kind, list(array.shape)])
        groups.setdefault(kind, []).append(array.reshape(-1))
    for kind, parts in groups.items():
        whole = np.concatenate(parts)
        writer.write(kind, whole, chunks=(max(1, min(len(whole), LARGEST_CHUNK)),))
    return table


def _read_packed(artifact: Artifact) -> dict[str, np.ndarray]:
    table: Any = artifact.attributes["table"]
    wholes = {kind: artifact.read(kind) for kind in artifact.names}
    taken = dict.fromkeys(wholes, 0)
    arrays = {}
    for name, kind, shape in table:
        start = taken[kind]
        taken[kind] = start + math.prod(shape)
        arrays[name] = wholes[kind][start : taken[kind]].reshape(shape)
    return arrays
