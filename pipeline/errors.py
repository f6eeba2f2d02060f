"""Everything that can go wrong, as it is reported to a person.

PipelineError            anything that the engine or a stage reports on purpose
├── UserError            bad input: one clear message, never a traceback
│   ├── WorkflowError    a workflow file or a `--set` is wrong: every problem at once, each with its place
│   ├── CommandError     the command line is wrong
│   └── RemoteError      a store in a bucket cannot be used: no such bucket, no credentials, access denied
│       └── Unreachable  its server cannot even be reached, on several attempts; also a TransientError
├── ArtifactError        a stage misused an artifact (wrong type of array, a name that leaves the directory)
│   └── CorruptArtifact  what is on the disk is not what was written
├── TransientError       a retry may well succeed, for example after a connection broke off
└── Interrupted          a stage saved its checkpoint because it was asked to stop
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from pipeline.plain_text import in_a_line, without_controls

LONGEST_FOUND = 500  # characters of what was found


class PipelineError(Exception):
    """Anything that the engine or a stage reports on purpose; the message is written for a person."""


class UserError(PipelineError):
    """Bad input: what is wrong, where, what was found, what was expected and what to do, in one line.

    >>> print(UserError("cannot read the picture", where="fox/7.jpg", found="10 bytes", expected="a JPEG or PNG",
    ...                 remedy="Export it again."))
    fox/7.jpg: cannot read the picture; found 10 bytes; expected a JPEG or PNG. Export it again.
    """

    def __init__(
        self,
        what: str,
        *,
        where: object = None,
        found: object = None,
        expected: object = None,
        remedy: str | None = None,
    ) -> None:
        message = f"{where}: {what}" if where is not None else what
        if found is not None:
            message += f"; found {in_a_line(str(found), LONGEST_FOUND)}"
        if expected is not None:
            message += f"; expected {expected}"
        if remedy is not None:
            stop = "" if message.endswith("?") else "."
            message = f"{message.rstrip('.')}{stop} {remedy[:1].upper()}{remedy[1:]}"
        super().__init__(without_controls(message, allowed="\n"))
        self.what = what
        self.where = where
        self.found = found
        self.expected = expected
        self.remedy = remedy


class CommandError(UserError):
    """The command line is wrong."""


@dataclass(frozen=True, order=True)
class Place:
    """Where something stands: a file with a 1-based line and column, or a `--set` option.

    For an option, `line` is 0 and `column` numbers the values in it; it is 0 for the whole.
    """

    file: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


@dataclass(frozen=True, order=True)
class Problem:
    """One thing that is wrong with a workflow."""

    place: Place
    message: str

    def __str__(self) -> str:
        return f"{self.place}: {self.message}"


class WorkflowError(UserError):
    """Everything that is wrong with a workflow, in the order of the file."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(sorted(set(problems)))
        super().__init__("\n".join(str(problem) for problem in self.problems))


class ArtifactError(PipelineError):
    """A stage misused an artifact; the message says which one and how."""


class CorruptArtifact(ArtifactError):
    """What is on the disk is not what was written: a file is missing, truncated or altered."""


class TransientError(PipelineError):
    """A retry may well succeed: a connection broke off, or a service is busy.

    A stage that raises it is tried again, with growing waits, and can resume from what it kept in `context.scratch`.
    """


class RemoteError(UserError):
    """A store in a bucket cannot be used: the bucket does not exist, or the credentials are missing or insufficient."""


class Unreachable(RemoteError, TransientError):
    """The server of a bucket could not be reached, or broke off, on several attempts."""


class Interrupted(PipelineError):
    """Raised by a stage that saw `context.stop_requested()` and has saved its checkpoint in `context.scratch`.

    Its message, if any, is shown to a person, such as "stopped while pictures were read".
    """


def nearest(name: str, allowed: Iterable[str]) -> str:
    """`; did you mean 'x'?`, or an empty text if no allowed name resembles `name`.

    >>> nearest("itertions", ["iterations", "width"])
    "; did you mean 'iterations'?"
    >>> nearest("zzz", ["iterations", "width"])
    ''
    """
    return nearest_of(name, {each: each for each in allowed})


def nearest_of(name: str, allowed: Mapping[str, object]) -> str:
    """Like `nearest`, but suggests what the allowed name maps to.

    >>> nearest_of("hide_photo", {"hide_photos": "workflows/hide_photos.yaml"})
    "; did you mean 'workflows/hide_photos.yaml'?"
    """
    close = difflib.get_close_matches(name, list(allowed), n=1, cutoff=0.6)
    return f"; did you mean {str(allowed[close[0]])!r}?" if close else ""
