"""Work done by dask: worker processes of our own on this machine, or a scheduler that runs already.

Only small descriptions and results go through dask, never arrays. It takes seconds to import, so this module is
imported when there is work to do.
"""

from __future__ import annotations

import faulthandler
import logging
import multiprocessing
import os
import queue
import signal
import uuid
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any

import dask
from distributed import Client, Future, LocalCluster, WorkerPlugin, get_worker
from distributed.scheduler import KilledWorker

from pipeline.errors import CommandError
from pipeline.events import Event, Noted, StageProgressed, StageStarted
from pipeline.executor import Lost, Tell, Work
from pipeline.orphans import end_with_parent
from pipeline.process import THREADS, KernelCache

SETTINGS: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": 0,  # else work that kills its worker kills four of them
    "distributed.scheduler.worker-ttl": None,  # a library that holds the interpreter for minutes is not dead
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.scheduler.no-workers-timeout": "60s",  # else work waits for ever when the last worker is gone
    "distributed.worker.multiprocessing-method": "spawn",  # forked OpenCL and OpenMP do not work
    "distributed.nanny.pre-spawn-environ": dict(THREADS),  # dask's own would allow one thread only
}
STANDARD_ERROR = 2  # where the log of the stage is, while it works
DIED = "its worker process died: killed from outside, out of memory, or crashed inside a library"
TOLD = {kind.__name__: kind for kind in (Noted, StageProgressed, StageStarted)}


@dataclass(frozen=True)
class Piece:
    """A piece of work; `again` after its worker died before it began, which is not its fault."""

    name: str
    work: Work
    subject: object
    urgency: int
    again: bool = False


class DaskExecutor:
    """Hands work to dask's workers, each a process that does one piece at a time.

    `address` names a scheduler that runs already; without one, `workers` processes are started here. Raises
    CommandError where nothing answers at the address.
    """

    def __init__(self, workers: int, address: str | None = None) -> None:
        self._run = uuid.uuid4().hex
        self._inbox: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._waiting: list[Piece] = []
        self._given: dict[str, tuple[Piece, Future]] = {}
        self._begun: set[str] = set()
        self._resources = ExitStack()
        self._resources.enter_context(dask.config.set(SETTINGS))
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        parent = os.getpid() if address is None else None
        if address is None:
            address = self._start_cluster(workers)
        try:
            self._client = Client(address, timeout="20s", set_as_default=False)
        except (OSError, ValueError) as error:
            self._resources.close()
            raise CommandError("no dask scheduler answers", where=f"--scheduler {address}", found=error) from error
        self._resources.callback(self._client.close, timeout=5)
        self._client.register_plugin(PrepareWorker(parent), name="prepare-worker")
        self._client.subscribe_topic(self._run, lambda event: self._inbox.put(("told", event[1])))

    def _start_cluster(self, workers: int) -> LocalCluster:
        others = multiprocessing.active_children()
        with _without_signals():
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                memory_limit=0,
                dashboard_address="127.0.0.1:0",  # no dashboard, and no quarrel over its port with another run
                scheduler_kwargs={"dashboard": False},
                silence_logs=logging.CRITICAL,
            )
        self._resources.callback(_kill_children, others)
        self._resources.callback(cluster.close, timeout=5)
        return cluster

    def start(self, name: str, work: Work, subject: object, urgency: int) -> None:
        self._waiting.append(Piece(name, work, subject, urgency))
        self._waiting.sort(key=lambda piece: -piece.urgency)

    def wait(self, tell: Tell, seconds: float) -> tuple[str, Any] | None:
        self._give()
        try:
            while True:
                what, content = self._inbox.get(timeout=seconds)
                if what == "told":
                    event = _event(content)
                    if isinstance(event, StageStarted):
                        self._begun.add(event.name)
                    tell(event)
                    continue
                piece, future = self._given.pop(content)
                if isinstance(future.exception(), KilledWorker) and content not in self._begun and not piece.again:
                    self._waiting.insert(0, replace(piece, again=True))
                    self._give()
                    continue
                return content, self._result(future)
        except queue.Empty:
            return None

    def _give(self) -> None:
        """Gives dask as many pieces as it has threads: a piece queued at a worker that dies would be blamed too."""
        if not self._waiting:
            return
        room = max(1, sum(self._client.nthreads().values())) - len(self._given)
        for piece in self._waiting[: max(0, room)]:
            key = f"{piece.name}-{uuid.uuid4().hex}"  # dask remembers the failures of a key
            future = self._client.submit(_work, piece.work, piece.subject, self._run, key=key, pure=False, retries=0)
            self._given[piece.name] = piece, future
            future.add_done_callback(lambda _, name=piece.name: self._inbox.put(("done", name)))
        del self._waiting[: max(0, room)]

    def close(self) -> None:
        self._waiting.clear()
        for _, future in self._given.values():
            future.cancel()
        self._resources.close()

    def _result(self, future: Future) -> Any:
        error = future.exception()
        if error is None:
            return future.result()
        if isinstance(error, KilledWorker):
            return Lost(DIED)
        return Lost(f"{type(error).__name__}: {error}")


class PrepareWorker(WorkerPlugin):
    """Gives each worker process its kernel cache, and has what crashes it leave a trace in the log of the stage.

    Workers of our own, children of the process `parent`, end with it.
    """

    def __init__(self, parent: int | None) -> None:
        self.parent = parent

    def setup(self, worker: Any) -> None:
        if self.parent is not None:
            end_with_parent(self.parent)
        faulthandler.enable(STANDARD_ERROR)
        self.kernel_cache = KernelCache()

    def teardown(self, worker: Any) -> None:
        self.kernel_cache.release()


@contextmanager
def _without_signals() -> Iterator[None]:
    """Processes and threads started meanwhile never see what asks a run to stop: the engine does, and tells them.

    What a terminal sends to all its processes at once, or a cluster's scheduler to all of a job, would else end workers
    before they save a checkpoint. For this thread it only waits until the end, so nothing is lost.
    """
    resource_tracker.ensure_running()  # by itself it starts with the first process, and lets signals through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _kill_children(others: Collection[BaseProcess]) -> None:
    """Ends workers that would not end when told to, or were not told since Ctrl-C interrupted that as well."""
    for child in multiprocessing.active_children():
        if child not in others:
            child.kill()


def _work(work: Work, subject: object, topic: str) -> Any:
    """What a worker does: the work, telling events over dask's own channel."""
    worker = get_worker()

    def tell(event: Event) -> None:
        worker.log_event(topic, {"type": type(event).__name__, "fields": asdict(event)})

    return work(subject, tell)


def _event(content: dict[str, Any]) -> Event:
    return TOLD[content["type"]](**content["fields"])
