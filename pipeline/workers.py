"""Worker processes: how those of our own are started, and what happens inside any of them."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from distributed import LocalCluster, WorkerPlugin, get_worker

from pipeline.events import Event, Noted, StageProgressed, StageStarted
from pipeline.executor import Work
from pipeline.loaded import check_engine, engine_digest
from pipeline.process import THREADS, KernelCache

SETTINGS: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": 0,  # else work that kills its worker kills four of them
    "distributed.scheduler.worker-ttl": None,  # a library that holds the interpreter for minutes is not dead
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.multiprocessing-method": "spawn",  # forked OpenCL and OpenMP do not work
    "distributed.nanny.pre-spawn-environ": dict(THREADS),  # dask's own would allow one thread only
}
TOLD = {kind.__name__: kind for kind in (Noted, StageProgressed, StageStarted)}


def start_workers(number: int) -> LocalCluster:
    """Processes on this machine, each doing one piece of work at a time, and a scheduler for them."""
    before = _ignore_interrupts()  # inherited: Ctrl-C is for the engine, which tells the workers
    try:
        return LocalCluster(
            n_workers=number,
            threads_per_worker=1,
            processes=True,
            memory_limit=0,  # dask would kill a worker that takes more
            dashboard_address="127.0.0.1:0",  # no dashboard, and no quarrel over its port with another run
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,
        )
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)


@contextmanager
def kept_environment() -> Iterator[None]:
    """Takes back what dask's nannies put into the environment of this process for that of their workers."""
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


class PrepareWorker(WorkerPlugin):
    """Gives each worker process its kernel cache, and lets Ctrl-C at the terminal pass it by."""

    def setup(self, worker: Any) -> None:
        _ignore_interrupts()
        engine_digest()  # of the sources that were imported just now, not of later ones
        self.kernel_cache = KernelCache()

    def teardown(self, worker: Any) -> None:
        self.kernel_cache.release()


def _ignore_interrupts() -> Any:
    try:
        return signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # not the main thread, which alone is interrupted
        return None


def work_at_worker(work: Work, subject: object, topic: str, engine: str) -> Any:
    """What a worker does: the work, telling events over dask's own channel. Raises UserError if its engine differs."""
    check_engine(engine)
    return work(subject, _teller(topic))


def _teller(topic: str) -> Callable[[Event], None]:
    worker = get_worker()

    def tell(event: Event) -> None:
        worker.log_event(topic, {"type": type(event).__name__, "fields": asdict(event)})

    return tell


def told_event(content: dict[str, Any]) -> Event:
    """The event that a worker told."""
    return TOLD[content["type"]](**content["fields"])
