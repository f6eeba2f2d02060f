"""Work done by dask: in worker processes of our own on this machine, or by a scheduler that is already running.

Only small descriptions and results go through dask, never arrays. This module decides what runs where and gives each
worker one piece at a time. So it knows what a dying worker was doing, dask retries nothing behind our back, and work
that no worker can do is not queued forever. The import takes seconds, so it happens only when there is work to do.
"""

from __future__ import annotations

import bisect
import logging
import math
import multiprocessing
import os
import queue
import time
import uuid
from collections import deque
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Any

import dask
from distributed import Client, Future, LocalCluster, Security
from distributed.scheduler import KilledWorker

from pipeline.code.engine_code import engine_digest
from pipeline.errors import CommandError, UserError
from pipeline.events import Noted
from pipeline.resources import MEMORY, Resources, of_this_machine
from pipeline.run.executor import Lost, Tell, Work
from pipeline.run.placement import Worker, lacking, place
from pipeline.run.workers import (
    SETTINGS,
    PrepareWorker,
    kept_environment,
    kill_children,
    start_workers,
    told_event,
    work_at_worker,
)

PATIENCE = 45.0  # seconds that work waits for a worker that could do it
SILENCE = 30.0  # seconds without an answer after which a scheduler is given up
SILENCE_HERE = 600.0  # the same for our own and its workers, which may be slow while others take the cores
LOOK_EVERY = 1.0  # seconds between two checks of the workers
ANSWER = 10.0  # seconds that a scheduler has to answer, and a worker to hand over a result
CLOSE = 5.0  # seconds that dask's processes have to exit
PAUSED = "paused"  # by dask, where it set a limit for memory that is nearly reached; what it does goes on
ALIVE = ("running", PAUSED)
DIED = "its worker process died: killed from outside, out of memory, or crashed inside a library"


@dataclass(frozen=True)
class Piece:
    """A piece of work, waiting for a worker or given to one."""

    name: str
    work: Work
    subject: object
    urgency: int
    needs: Resources


@dataclass(frozen=True)
class Given:
    """A piece that a worker is doing."""

    piece: Piece
    worker: Worker
    future: Future


class DaskExecutor:
    """Hands work to dask's workers, one piece at a time to each.

    `address` is that of a running scheduler. Without one, starts `workers` processes here, which share this machine's
    memory and the stated `resources`. Work that no worker can do is given up after `patience` seconds, or at once if
    the workers are our own. If all of these have died, it waits for them to be started again. Raises CommandError if
    nothing answers at the address, or if a worker cannot load this package.
    """

    def __init__(
        self, workers: int, address: str | None = None, resources: Resources | None = None, patience: float = PATIENCE
    ) -> None:
        self._address = address
        self._machine = of_this_machine(resources or {}) if address is None else None
        self._patience = patience
        self._run = uuid.uuid4().hex
        self._inbox: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._waiting: list[Piece] = []
        self._given: dict[str, Given] = {}
        self._lost: deque[tuple[str, Lost]] = deque()
        self._workers: list[Worker] = []
        self._busy: frozenset[str] = frozenset()
        self._hopeless_since: dict[tuple[tuple[str, float], ...], float] = {}
        self._looked = 0.0
        self._changed = False
        self._silence = 0.0
        self._ends = ExitStack()
        self._ends.enter_context(kept_environment())
        self._ends.enter_context(dask.config.set(SETTINGS))
        for logger in ("distributed", "distributed.client"):  # dask sets a separate level for the second
            logging.getLogger(logger).setLevel(logging.CRITICAL)
        cluster = None
        if address is None:
            self._ends.callback(kill_children, multiprocessing.active_children())
            cluster = start_workers(workers)
            # If closing is interrupted, dask would wait ten seconds at exit for processes that are already killed.
            self._ends.callback(setattr, cluster, "shutdown_on_close", False)
            self._ends.callback(_closed, cluster)
        self._client = self._connected(cluster or address)

    def _connected(self, cluster: Any) -> Client:
        where = f"--scheduler {self._address}"
        if self._address is not None and (refusal := _refusal(self._address, where)):
            self._ends.close()
            raise refusal
        try:
            client = Client(cluster, timeout="20s", set_as_default=False)
        except (OSError, ValueError) as error:
            self._ends.close()
            raise CommandError("no dask scheduler answers", where=where, found=error) from error
        self._ends.callback(_closed, client)
        try:
            client.register_plugin(PrepareWorker(None if self._address else os.getpid()), name="prepare-worker")
        except Exception as error:  # whatever is raised in a worker that lacks our package, or has another version
            self._ends.close()
            found = f"{type(error).__name__}: {error}"
            if self._address is None:
                raise CommandError("a worker on this machine cannot start", found=found) from error
            raise CommandError(
                "the workers cannot load this program",
                where=where,
                found=found,
                remedy="Start them with the same Python environment, and PYTHONPATH set to this project's folder.",
            ) from error
        client.subscribe_topic(self._run, lambda event: self._inbox.put(("told", event[1])))
        return client

    def start(self, name: str, work: Work, subject: object, urgency: int, needs: Resources) -> None:
        bisect.insort(self._waiting, Piece(name, work, subject, urgency, needs), key=lambda piece: -piece.urgency)
        self._changed = True

    def wait(self, tell: Tell, seconds: float) -> tuple[str, Any] | None:
        self._look()
        self._give(tell)
        if self._lost:
            return self._lost.popleft()
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            try:
                what, content = self._inbox.get(timeout=left)
            except queue.Empty:
                break
            if what == "told":
                tell(told_event(content))
            elif content in self._given:
                given = self._given.pop(content)
                self._changed = True
                return given.piece.name, self._result(given)
        return None

    def _give(self, tell: Tell) -> None:
        """Hands pieces to free workers that have what they need; gives up pieces that wait in vain."""
        if not self._changed or self._client.status != "running":
            return
        self._changed = False
        held: list[Piece] = []
        free = [worker for worker in self._workers if worker.address not in self._busy]
        taken = {given.worker.address: given.piece.needs for given in self._given.values()}
        for piece in self._waiting:
            worker = place(piece.needs, free, taken)
            if worker:
                taken[worker.address] = piece.needs
                self._submit(piece, worker)
            elif not self._is_hopeless(piece, tell):
                held.append(piece)
        self._waiting = held

    def _submit(self, piece: Piece, worker: Worker) -> None:
        key = f"{piece.name}-{uuid.uuid4().hex}"  # dask remembers the failures of a key
        future = self._client.submit(
            work_at_worker,
            piece.work,
            piece.subject,
            self._run,
            engine_digest(),
            key=key,
            pure=False,
            retries=0,
            workers=[worker.address],
            allow_other_workers=False,
            resources={name: value for name, value in piece.needs.items() if name in worker.counted},
        )
        self._given[key] = Given(piece, worker, future)
        future.add_done_callback(lambda _: self._inbox.put(("done", key)))

    def _is_hopeless(self, piece: Piece, tell: Tell) -> bool:
        """Whether a piece has waited long enough for a worker that could do it; on this machine none will come."""
        kind = tuple(sorted(piece.needs.items()))
        missing = lacking(piece.needs, self._workers)
        if missing is None:
            self._hopeless_since.pop(kind, None)
            return False
        patience = self._patience
        if self._machine is not None:
            patience = 0.0 if self._workers else SILENCE_HERE  # they are all being started again, which takes a while
        if patience and kind not in self._hopeless_since:
            tell(Noted(f"{piece.name} {missing}; waiting {patience:.0f} s for one"))
        since = self._hopeless_since.setdefault(kind, time.monotonic())
        if time.monotonic() - since < patience:
            return False
        self._lost.append((piece.name, Lost(f"{missing}. {self._remedy(piece.needs)}")))
        return True

    def _remedy(self, needs: Resources) -> str:
        listed = " ".join(f"{name}={value:.15g}" for name, value in needs.items())
        if self._address is None and not self._workers:
            died = "The worker processes of this run died and did not come back"
            return f"{died}: perhaps there is too little memory for as many (--workers 1). Give the command again."
        if self._address is None:
            return f"If it has more: --resources '{listed}'. Otherwise change the stage's 'resources' in the workflow."
        stated = f" --resources '{listed}'" if listed else ""
        return f"Start one with: dask worker {self._address} --nthreads 1 --memory-limit 0{stated}"

    def _look(self) -> None:
        """Asks the scheduler once a second which workers there are; what a vanished worker was doing is lost."""
        now = time.monotonic()
        if now - self._looked < LOOK_EVERY:
            return
        self._looked = now
        answer = self._asked()
        if answer is None:
            # Time spent waiting, not time passed: after a suspension (Ctrl-Z) any last answer is old.
            self._silence += LOOK_EVERY + min(time.monotonic() - now, ANSWER)
            enough = SILENCE_HERE if self._address is None else min(SILENCE, self._patience)
            if self._client.status in ("closing", "closed") or self._silence > enough:
                self._give_up()
            return
        found, processing = answer
        self._silence = 0.0
        self._changed = True
        self._workers = [self._worker(address, facts) for address, facts in found.items() if facts["status"] in ALIVE]
        self._busy = frozenset(
            address
            for address, facts in found.items()
            if facts["status"] == PAUSED or not self._given.keys() >= set(processing.get(address, ()))
        )
        for key, given in list(self._given.items()):
            if given.worker.address not in found and given.future.status == "pending":
                del self._given[key]
                given.future.cancel()
                self._lost.append((given.piece.name, Lost(DIED, transient=True)))

    def _asked(self) -> tuple[Mapping[str, Any], Mapping[str, Any]] | None:
        """Facts about each worker, and the keys of all work that each is doing, ours or not; None if nobody answers."""
        if self._client.status != "running":
            return None
        try:
            found = self._client.sync(self._client.scheduler.identity, callback_timeout=ANSWER)["workers"]
            return found, self._client.sync(self._client.scheduler.processing, callback_timeout=ANSWER)
        except (OSError, TimeoutError, AttributeError, RuntimeError):  # closed meanwhile: it has no scheduler any more
            return None

    def _worker(self, address: str, facts: Mapping[str, Any]) -> Worker:
        if self._machine is not None:
            return Worker(address, self._machine, shared=True)
        stated: dict[str, float] = facts["resources"]
        memory = float(facts["memory_limit"] or math.inf)
        return Worker(address, {MEMORY: memory} | stated, counted=frozenset(stated))

    def _give_up(self) -> None:
        """Gives everything up as lost: the scheduler has been silent for too long."""
        lost = Lost(f"the dask scheduler{f' at {self._address}' if self._address else ''} no longer answers")
        names = [*(given.piece.name for given in self._given.values()), *(piece.name for piece in self._waiting)]
        self._lost.extend((name, lost) for name in names)
        self._given.clear()
        self._waiting.clear()

    def _result(self, given: Given) -> Any:
        if given.future.status in ("cancelled", "lost"):
            return Lost("the connection to the dask scheduler was lost")
        try:
            return given.future.result(timeout=ANSWER)
        except (KilledWorker, TimeoutError):
            return Lost(DIED, transient=True)
        except UserError as error:
            return Lost(str(error))
        except Exception as error:  # raised in sending the work, not by the work, which raises nothing
            return Lost(f"{given.worker.address} cannot do the work: {type(error).__name__}: {error}")

    def close(self) -> None:
        self._waiting.clear()
        for given in self._given.values():
            given.future.cancel()
        self._ends.close()


def _refusal(address: str, where: str) -> CommandError | None:
    """What is wrong with an address at which dask would try for a minute, and print a traceback."""
    if ":" not in address:
        return CommandError("not the address of a dask scheduler", where=where, expected="HOST:PORT")
    if address.startswith("tls://") and Security().get_connection_args("client").get("ssl_context") is None:
        return CommandError(
            "the dask scheduler cannot be asked without certificates",
            where=where,
            remedy="Set DASK_DISTRIBUTED__COMM__TLS__… for the run as for the scheduler.",
        )
    return None


def _closed(opened: Client | LocalCluster) -> None:
    """Closes a client or cluster. On a busy machine that may time out, but finished work is not affected."""
    with suppress(OSError, TimeoutError):
        opened.close(timeout=CLOSE)
