"""Worker processes: how those of our own are started, and what happens inside any of them."""

from __future__ import annotations

import faulthandler
import logging
import multiprocessing
import os
import signal
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any

from distributed import LocalCluster, WorkerPlugin, get_worker

from pipeline.cuda_process import cuda_is_broken, return_gpu_memory
from pipeline.engine_code import check_engine, engine_digest
from pipeline.events import Event, Noted, StageProgressed, StageStarted
from pipeline.executor import Work
from pipeline.freed_memory import keep_freed_memory, return_freed_memory
from pipeline.orphans import end_with_parent
from pipeline.process import THREADS, KernelCache

SETTINGS: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": 0,  # else work that kills its worker kills four of them
    "distributed.scheduler.worker-ttl": None,  # a library that holds the interpreter for minutes is not dead
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.multiprocessing-method": "spawn",  # forked OpenCL and OpenMP do not work
    "distributed.nanny.pre-spawn-environ": dict(THREADS),  # dask's own would allow one thread only
    # What dask watches by default, nobody reads here. Each process that only waits takes 3 % of a core for it, and with
    # these settings 0.5 %; while a stage works, its thread gives way to a sampling profiler a hundred times a second.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}
STOPPING = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
STANDARD_ERROR = 2  # where the log of the stage is, while it works
TOLD = {kind.__name__: kind for kind in (Noted, StageProgressed, StageStarted)}


def start_workers(number: int) -> LocalCluster:
    """Processes on this machine, each doing one piece of work at a time, and a scheduler for them.

    Whoever can talk to them can have anything done in this user's name. So they talk with certificates made for this
    one run and held by its processes alone: other users of this machine reach the port, and are refused.
    """
    with _without_signals():
        return LocalCluster(
            n_workers=number,
            threads_per_worker=1,
            processes=True,
            security=True,
            memory_limit=0,  # dask would kill a worker that takes more
            dashboard_address="127.0.0.1:0",  # no dashboard, and no quarrel over its port with another run
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,
        )


@contextmanager
def _without_signals() -> Iterator[None]:
    """Processes and threads started meanwhile never see what asks a run to stop: the engine does, and tells them.

    What a terminal sends to all its processes at once, or a cluster's scheduler to all of a job, would else end workers
    before they save a checkpoint. For this thread it only waits until the end, so nothing is lost.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
    try:
        resource_tracker.ensure_running()  # by itself it starts with the first process, and lets signals through again
        signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def kill_children(others: Collection[BaseProcess]) -> None:
    """Ends workers that would not end when told to, or were not told since Ctrl-C interrupted that as well."""
    for child in multiprocessing.active_children():
        if child not in others:
            child.kill()


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
    """Gives each worker process its kernel cache, and has what crashes it leave a trace in the log of the stage.

    Workers of our own, children of the process `parent`, end with it.
    """

    def __init__(self, parent: int | None) -> None:
        self.parent = parent

    def setup(self, worker: Any) -> None:
        if self.parent is not None:
            end_with_parent(self.parent)
        faulthandler.enable(STANDARD_ERROR)
        keep_freed_memory()
        engine_digest()  # of the sources that were imported just now, not of later ones
        self.kernel_cache = KernelCache()

    def teardown(self, worker: Any) -> None:
        self.kernel_cache.release()


def work_at_worker(work: Work, subject: object, topic: str, engine: str) -> Any:
    """What a worker does: the work, telling events over dask's own channel. Raises UserError if its engine differs.

    A process in which CUDA no longer works ends instead: what it was given is then given to the one in its place.
    """
    check_engine(engine)
    if cuda_is_broken():
        os._exit(1)
    try:
        return work(subject, _teller(topic))
    finally:
        return_freed_memory()
        return_gpu_memory()


def _teller(topic: str) -> Callable[[Event], None]:
    worker = get_worker()

    def tell(event: Event) -> None:
        worker.log_event(topic, {"type": type(event).__name__, "fields": asdict(event)})

    return tell


def told_event(content: dict[str, Any]) -> Event:
    """The event that a worker told."""
    return TOLD[content["type"]](**content["fields"])
