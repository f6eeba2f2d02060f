"""Worker processes: how our own are started, and what happens inside all of them."""

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

from pipeline.code.engine_code import check_engine, engine_digest
from pipeline.events import Event, Noted, StageProgressed, StageStarted
from pipeline.orphans import end_with_parent
from pipeline.run.cuda_process import cuda_is_broken, return_gpu_memory
from pipeline.run.executor import Work
from pipeline.run.freed_memory import keep_freed_memory, return_freed_memory
from pipeline.run.process import THREADS, KernelCache, set_thread_policy

SETTINGS: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": 0,  # otherwise work that kills its worker would kill four
    "distributed.scheduler.worker-ttl": None,  # a worker whose library holds the GIL for minutes is not dead
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.multiprocessing-method": "spawn",  # OpenCL and OpenMP do not survive a fork
    "distributed.nanny.pre-spawn-environ": dict(THREADS),  # dask's default allows only one thread
    # Nobody reads what dask monitors by default. For it, each idle process takes 3 % of a core, and 0.5 % with these
    # settings; and while a stage works, a sampling profiler interrupts its thread a hundred times a second.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}
STOPPING = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
STANDARD_ERROR = 2  # leads to the log of a stage while it runs
TOLD = {kind.__name__: kind for kind in (Noted, StageProgressed, StageStarted)}


def start_workers(number: int) -> LocalCluster:
    """Processes on this machine, each doing one piece of work at a time, and a scheduler for them.

    Anyone who can talk to them can run anything in this user's name. So they use certificates that are made for this
    one run and held only by its processes: other users of this machine can reach the port, but are refused.
    """
    with _without_signals():
        return LocalCluster(
            n_workers=number,
            threads_per_worker=1,
            processes=True,
            security=True,
            memory_limit=0,  # no limit: dask would kill a worker that exceeds it
            dashboard_address="127.0.0.1:0",  # no dashboard, and no conflict over its port with another run
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,
        )


@contextmanager
def _without_signals() -> Iterator[None]:
    """Hides the signals that ask a run to stop from processes and threads started in the block: the engine tells them.

    Otherwise a signal that a terminal sends to all its processes at once, or a cluster's scheduler to all of a job,
    would end workers before they save a checkpoint. In this thread it only waits until the block ends, so none is lost.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
    try:
        resource_tracker.ensure_running()  # otherwise it starts with the first process, and unblocks signals
        signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def kill_children(others: Collection[BaseProcess]) -> None:
    """Kills all child processes but `others`: workers that did not end when told, or were not told due to Ctrl-C."""
    for child in multiprocessing.active_children():
        if child not in others:
            child.kill()


@contextmanager
def kept_environment() -> Iterator[None]:
    """Restores this process's environment after the block: dask's nannies set variables in it for their workers."""
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


class PrepareWorker(WorkerPlugin):
    """Gives each worker process its kernel cache, and makes a crash leave a traceback in the log of the stage.

    Our own workers, children of the process `parent`, end with it.
    """

    def __init__(self, parent: int | None) -> None:
        self.parent = parent

    def setup(self, worker: Any) -> None:
        set_thread_policy()  # workers of a cluster were not started by us
        if self.parent is not None:
            end_with_parent(self.parent)
        faulthandler.enable(STANDARD_ERROR)
        keep_freed_memory()
        engine_digest()  # computed and cached now, for the sources that were just imported
        self.kernel_cache = KernelCache()

    def teardown(self, worker: Any) -> None:
        self.kernel_cache.release()


def work_at_worker(work: Work, subject: object, topic: str, engine: str) -> Any:
    """Does a piece of work in a worker, and reports events over dask's channel. Raises UserError if its engine differs.

    A process in which CUDA no longer works exits instead, and the work goes to the process that replaces it.
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
    """The event that a worker reported."""
    return TOLD[content["type"]](**content["fields"])
