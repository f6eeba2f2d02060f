"""Companions: processes that work for a stage, `python -m MODULE JOB`, and report progress as JSON lines.

A stage uses companions if its own process will not do: for a library that would harm it, or for Python code on more
than one core. The process of a stage may be a daemon, which `multiprocessing` does not allow to have children; and a
stage and its companions exchange plain files, not pickles.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

from pipeline.canonical import Json
from pipeline.errors import UserError
from pipeline.orphans import end_with_parent

POLLING = 0.2  # seconds
TRACEBACK = "Traceback (most recent call last)"
ROOT = Path(__file__).resolve().parents[1]

Said = Mapping[str, Any]


def work_together(
    what: str,
    module: str,
    jobs: Sequence[Path],
    heard: Callable[[Said], None],
    watch: Callable[[], None],
    remedy: str | None = None,
) -> None:
    """Runs `module` once for each of the files `jobs`, all at the same time, and waits until all have ended.

    `heard` is called with each object that a companion sends, `watch` several times a second. If either raises, or a
    companion fails, all are killed. A companion's standard error goes to a file beside its job, with the suffix `.log`.
    Raises UserError, which calls the work `what`, if an exit status is not 0. The error includes `remedy`, which is for
    lack of memory, unless the companion raised an exception other than MemoryError.
    """
    lines: queue.Queue[tuple[int, bytes | None]] = queue.Queue()
    with ExitStack() as ends:
        companions = [_start(module, job, ends) for job in jobs]
        for number, companion in enumerate(companions):
            assert companion.stdout is not None
            threading.Thread(target=_listen, args=(number, companion.stdout, lines), daemon=True).start()
        working = len(companions)
        while working:
            watch()
            try:
                number, line = lines.get(timeout=POLLING)
            except queue.Empty:
                continue
            if line is not None:
                heard(json.loads(line))
                continue
            working -= 1
            status = companions[number].wait()
            if status != 0:
                raise _broken_off(what, status, jobs[number].with_suffix(".log"), remedy)


def _start(module: str, job: Path, ends: ExitStack) -> subprocess.Popen[bytes]:
    given = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))  # an empty entry is the current folder
    paths = [str(ROOT), *(str(Path(path).absolute()) for path in given)]
    log = ends.enter_context(job.with_suffix(".log").open("wb"))
    companion = subprocess.Popen(
        [sys.executable, "-P", "-m", module, str(job)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=log,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        start_new_session=True,  # Ctrl-C reaches the engine, which asks to stop
    )

    def end() -> None:
        companion.kill()
        companion.wait()

    ends.callback(end)
    return companion


def _listen(number: int, stream: IO[bytes], lines: queue.Queue[tuple[int, bytes | None]]) -> None:
    for line in stream:
        lines.put((number, line))
    lines.put((number, None))


def _broken_off(what: str, status: int, log: Path, remedy: str | None) -> UserError:
    lines = log.read_text(errors="replace").strip().splitlines()
    lines = [line for line in lines if not line.lstrip().startswith("@")]  # without the stack dump of a crash
    if any(line.startswith(TRACEBACK) for line in lines) and not lines[-1].startswith("MemoryError"):
        return UserError(f"{what} failed", found=lines[-1].removeprefix("ValueError: "))
    return UserError(
        f"{what} failed",
        found=f"exit status {status}: {' | '.join(lines[-3:]) or 'no message'}",
        expected="exit status 0; -9 means that it was killed, usually for lack of memory",
        remedy=remedy,
    )


def say(**facts: Json) -> None:
    """For use in a companion: sends `facts` to the stage, as a JSON object."""
    print(json.dumps(facts), flush=True)


def end_with_stage() -> None:
    """For use in a companion, first of all: ends it with the stage's process, which closes the standard input."""
    end_with_parent(os.getppid())
    threading.Thread(target=_await_end, daemon=True).start()


def _await_end() -> None:
    while os.read(sys.stdin.fileno(), 1024):  # unbuffered: a buffer's lock would abort the interpreter at its exit
        pass
    os._exit(1)
