"""Events during a run, as the engine reports them to a display."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

StageState = Literal["ran", "cached", "failed", "skipped"]


@dataclass(frozen=True)
class StageStarted:
    """A stage began to work."""

    name: str


@dataclass(frozen=True)
class StageProgressed:
    """How far a running stage is: `done` of `total`, with current figures such as a PSNR."""

    name: str
    done: float
    total: float
    figures: Mapping[str, float]


@dataclass(frozen=True)
class StageEnded:
    """A stage ended, or was skipped: `cause` says why it failed or was skipped, `log` where to read more."""

    name: str
    state: StageState
    key: str | None
    seconds: float
    outputs: Mapping[str, Path]
    cause: str | None = None
    log: Path | None = None


@dataclass(frozen=True)
class Remarked:
    """What a person should know about a result that a stage just made; `log` is where to read more, if there is more.

    A remark that is `as_wished` is not repeated when the run ends.
    """

    name: str
    text: str
    log: Path | None = None
    as_wished: bool = False


@dataclass(frozen=True)
class Noted:
    """Something that a person should know, such as what the run waits for, or where something is."""

    text: str


@dataclass(frozen=True)
class Summary:
    """The end of a run: how many stages ended in each state."""

    seconds: float
    counts: Mapping[StageState, int] = field(default_factory=dict)
    interrupted: bool = False


Event = StageStarted | StageProgressed | StageEnded | Remarked | Noted | Summary


def as_json(event: Event) -> str | None:
    """The line that `--json` prints for an event; None for events that it does not print.

    >>> as_json(StageEnded("cover", "cached", "5e", 0.0, {"scene": Path("ab")}))
    '{"event": "stage", "name": "cover", "state": "cached", "key": "5e", "seconds": 0.0, "outputs": {"scene": "ab"}}'
    """
    if isinstance(event, StageEnded):
        content = {
            "event": "stage",
            "name": event.name,
            "state": event.state,
            "key": event.key,
            "seconds": round(event.seconds, 3),
            "outputs": {name: str(path) for name, path in event.outputs.items()},
        }
    elif isinstance(event, Summary):
        counts = {state: event.counts.get(state, 0) for state in ("ran", "cached", "failed", "skipped")}
        content = {"event": "summary", **counts, "seconds": round(event.seconds, 3)}
    else:
        return None
    return json.dumps(content)
