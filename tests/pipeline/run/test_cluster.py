"""Runs on a cluster, its scheduler and workers separate processes: resources, and what happens when a process dies."""

from __future__ import annotations

import errno
import multiprocessing
import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import dask
import pytest
from distributed import Client, LocalCluster, Security, Status

from pipeline.errors import CommandError
from pipeline.events import Noted
from pipeline.resources import MEMORY
from pipeline.run import cluster as cluster_module
from pipeline.run.cluster import LOOK_EVERY, DaskExecutor
from pipeline.run.placement import lacking
from pipeline.run.workers import SETTINGS, start_workers
from tests.pipeline.dask_cluster import ROOT, Cluster, wait_until
from tests.pipeline.helpers import Ran, Workspace
from tests.pipeline.test_cli import start


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with Cluster(tmp_path_factory.mktemp("cluster")) as started:
        started.worker("plain", "memory=1e9")
        started.worker("accelerated", "gpu=1 memory=1e9")
        started.await_workers(2)
        yield started


class Background:
    """A run on a cluster, in a thread of its own."""

    def __init__(self, workspace: Workspace, executor: DaskExecutor) -> None:
        self.ran: Ran | None = None

        def run() -> None:
            self.ran = workspace.run(executor=executor)

        self.thread = threading.Thread(target=run)
        self.thread.start()

    def result(self) -> Ran:
        self.thread.join(timeout=100)
        assert self.ran is not None, "the run hangs"
        return self.ran


def notes(ran: Ran) -> list[str]:
    return [event.text for event in ran.events if isinstance(event, Noted)]


def gates(workspace: Workspace, labels: str, resources: str = "{}") -> Path:
    """Writes stages that wait for a gate; returns the folder where they report that they began."""
    folder = workspace.folder / "gates"
    folder.mkdir(exist_ok=True)
    lines = [
        f"  {label}: {{uses: gate, resources: {resources}, with: {{folder: {folder}, label: {label}}}}}"
        for label in labels
    ]
    workspace.write("\n".join(["stages:", *lines]))
    return folder


def test_resources_choose_the_worker(workspace: Workspace, cluster: Cluster) -> None:
    """Two stages that want the only GPU run in turn; one that no worker can run fails and holds up no other."""
    folder = gates(workspace, "ab", "{gpu: 1, memory: 500 MB}")
    with workspace.file.open("a") as file:
        file.write("\n  huge: {uses: numbers, resources: {memory: 2 TB, gpu: 3}}")
        file.write("\n  after: {uses: scale, in: {numbers: huge}}")
        file.write("\n  fine: {uses: numbers}\n")
    run = Background(workspace, DaskExecutor(0, cluster.address, patience=2.0))
    wait_until((folder / "a").is_file, "a began")
    wait_until(lambda: bool(list(workspace.folder.glob("store/latest/workflow/fine.*"))), "fine ended beside it")
    assert not (folder / "b").exists()
    (folder / "open").touch()
    ran = run.result()
    assert ran.states == {"a": "ran", "b": "ran", "huge": "failed", "after": "skipped", "fine": "ran"}
    cause = str(ran.ended["huge"].cause)
    assert cause.startswith("needs memory 1.819 TiB and gpu 3, which no worker has (tcp://127.0.0.1:")
    assert "has memory 953.7 MiB and gpu 1" in cause
    start = f"Start one with: dask worker {cluster.address} --nthreads 1 --memory-limit 0"
    assert cause.endswith(f"{start} --resources 'memory=2000000000000 gpu=3'")
    assert len([note for note in notes(ran) if "waiting 2 s for one" in note]) == 1
    processes = {ran.project.store.record(str(ran.ended[name].key)).provenance["facts"]["process"] for name in "ab"}  # type: ignore[union-attr]
    assert processes == {cluster.processes["accelerated"].pid}


def test_resources_are_not_in_the_key(workspace: Workspace) -> None:
    workspace.write("stages:\n  a: {uses: numbers}\n").run()
    workspace.write("stages:\n  a: {uses: numbers, resources: {memory: 1 GiB}}\n")
    assert workspace.run().states == {"a": "cached"}


def test_other_code_at_the_worker_is_refused(workspace: Workspace, tmp_path: Path) -> None:
    """First a stage's code, then the engine's: either would have stored wrong results under a valid key."""
    copy = tmp_path / "copy"
    for package in ("pipeline", "tests"):
        shutil.copytree(ROOT / package, copy / package, ignore=shutil.ignore_patterns("__pycache__"))
    toy = copy / "tests" / "pipeline" / "toys" / "scale.py"
    toy.write_text(toy.read_text().replace("values * parameters.factor", "values + parameters.factor"))
    workspace.write("stages:\n  a: {uses: numbers}\n  b: {uses: scale, in: {numbers: a}}\n")
    with Cluster(tmp_path) as cluster:
        worker = cluster.worker("other", sources=copy)
        ran = workspace.run(executor=DaskExecutor(0, cluster.address))
        assert ran.states == {"a": "ran", "b": "failed"}
        assert "planned; found another version of tests.pipeline.toys.scale" in str(ran.ended["b"].cause)
        worker.kill()
        worker.wait()
        with (copy / "pipeline" / "errors.py").open("a") as file:
            file.write("OTHER = True\n")
        cluster.worker("engine", sources=copy)
        ran = workspace.run(executor=DaskExecutor(0, cluster.address))
        assert ran.states == {"a": "cached", "b": "failed"}
        assert "the worker has a different version of the engine than the run" in str(ran.ended["b"].cause)


def test_interrupted_on_a_cluster(workspace: Workspace, cluster: Cluster) -> None:
    """Ctrl-C asks the cluster's workers to stop; they remain for the next run."""
    folder = gates(workspace, "ab")
    process = start(workspace, "run", "--scheduler", cluster.address)
    wait_until(lambda: (folder / "a").is_file() and (folder / "b").is_file(), "both workers work")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=100)
    assert process.returncode == 130
    assert "a: skipped: stopped" in err
    assert "Traceback" not in err
    (folder / "open").touch()
    assert set(workspace.run(executor=DaskExecutor(0, cluster.address)).states.values()) == {"ran"}


def test_workers_of_this_machine_share_what_it_has(workspace: Workspace) -> None:
    """A large and a small stage run together, two large ones in turn; one that is too large fails."""
    folder = gates(workspace, "ab", "{memory: 3 GB}")
    with workspace.file.open("a") as file:
        file.write("\n  c: {uses: numbers, resources: {memory: 1 GB}}")
        file.write("\n  d: {uses: numbers, resources: {memory: 6 GB}, with: {first: 5}}\n")
    before = dict(os.environ)
    run = Background(workspace, DaskExecutor(2, resources={"memory": 5e9}))
    wait_until((folder / "a").is_file, "a began")
    wait_until(lambda: bool(list(workspace.folder.glob("store/latest/workflow/c.*"))), "c ended beside it")
    assert not (folder / "b").exists()
    (folder / "open").touch()
    ran = run.result()
    assert ran.states == {"a": "ran", "b": "ran", "c": "ran", "d": "failed"}
    assert str(ran.ended["d"].cause).startswith("needs memory 5.588 GiB, but this machine has memory 4.657 GiB.")
    assert notes(ran) == [], "no worker of this machine can come to have more: there is nothing to wait for"
    assert dict(os.environ) == before, "dask's nanny sets variables for its workers, which leaked into this process"


def test_a_killed_worker_costs_only_what_it_did(workspace: Workspace, cluster: Cluster) -> None:
    """Its stage fails, what the other worker did is kept, and the next run completes on the worker that is left."""
    folder = gates(workspace, "abc")
    run = Background(workspace, DaskExecutor(0, cluster.address, patience=2.0))
    wait_until(lambda: (folder / "a").is_file() and (folder / "b").is_file(), "both workers work")
    owner = {int((folder / name).read_text()): name for name in "ab"}
    victim = owner[cluster.processes["plain"].pid]
    cluster.processes["plain"].kill()
    cluster.processes["plain"].wait()
    (folder / "open").touch()
    ran = run.result()
    assert ran.states == {name: "failed" if name == victim else "ran" for name in "abc"}
    assert "its worker process died" in str(ran.ended[victim].cause)
    again = workspace.run(executor=DaskExecutor(0, cluster.address))
    assert again.states == {name: "ran" if name == victim else "cached" for name in "abc"}


def test_without_workers_or_scheduler_a_run_ends(workspace: Workspace, tmp_path: Path) -> None:
    """The only worker dies, and no other comes; then the scheduler dies in the middle of a stage."""
    folder = gates(workspace, "ab")
    with Cluster(tmp_path) as cluster:
        first = cluster.worker("first")
        cluster.await_workers(1)
        run = Background(workspace, DaskExecutor(0, cluster.address, patience=1.0))
        wait_until((folder / "a").is_file, "a began")
        first.kill()
        ran = run.result()
        assert ran.states == {"a": "failed", "b": "failed"}
        assert "its worker process died" in str(ran.ended["a"].cause)
        assert "needs a worker, but there is no worker. Start one" in str(ran.ended["b"].cause)
        (folder / "a").unlink()
        cluster.worker("second")
        cluster.await_workers(1)
        run = Background(workspace, DaskExecutor(0, cluster.address, patience=1.0))
        wait_until((folder / "a").is_file, "a began again")
        cluster.scheduler.kill()
        ran = run.result()
        assert ran.states == {"a": "failed", "b": "failed"}
        assert "the connection to the dask scheduler was lost" in str(ran.ended["a"].cause)
        assert f"the dask scheduler at {cluster.address} no longer answers" in str(ran.ended["b"].cause)


def test_a_run_that_was_stopped_goes_on(
    workspace: Workspace, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Suspended for an hour by Ctrl-Z, twice: what it was just asking the living scheduler is not answered in time."""
    folder = gates(workspace, "a")
    executor = DaskExecutor(0, cluster.address)
    asked, clock, stops, stopped = executor._asked, time.monotonic, iter([3600.0, 3600.0]), threading.Event()
    passed = [0.0]
    monkeypatch.setattr("pipeline.run.cluster.time.monotonic", lambda: clock() + sum(passed))

    def asked_as_it_was_stopped() -> object:
        if not (folder / "a").is_file():
            return asked()
        if (stop := next(stops, None)) is None:
            stopped.set()
            return asked()
        passed.append(stop)
        return None

    monkeypatch.setattr(executor, "_asked", asked_as_it_was_stopped)
    run = Background(workspace, executor)
    assert stopped.wait(timeout=60)
    (folder / "open").touch()
    assert run.result().states == {"a": "ran"}


def test_a_worker_that_dask_pauses_is_not_gone(workspace: Workspace, tmp_path: Path) -> None:
    """Dask pauses a worker whose memory it limits; what waits for it waits until it works again."""
    folder = gates(workspace, "ab")
    with Cluster(tmp_path) as own, Client(own.address, set_as_default=False) as client:
        own.worker("only")
        own.await_workers(1)
        run = Background(workspace, DaskExecutor(0, own.address, patience=1.0))
        wait_until(lambda: any((folder / label).exists() for label in "ab"), "the first stage works")
        client.run(lambda dask_worker: setattr(dask_worker, "status", Status.paused))
        time.sleep(3 * LOOK_EVERY)
        client.run(lambda dask_worker: setattr(dask_worker, "status", Status.running))
        (folder / "open").touch()
        ran = run.result()
    assert ran.states == {"a": "ran", "b": "ran"}


def test_without_certificates_no_scheduler_that_wants_them_is_asked() -> None:
    with pytest.raises(CommandError, match="cannot be asked without certificates"):
        DaskExecutor(0, "tls://127.0.0.1:9")


def test_a_worker_of_a_cluster_has_all_memory_and_threads_that_sleep(tmp_path: Path) -> None:
    with Cluster(tmp_path) as own, Client(own.address, set_as_default=False) as client:
        own.worker("only")
        own.await_workers(1)
        executor = DaskExecutor(0, own.address)
        executor.wait(lambda event: None, 0.0)
        assert "--memory-limit 0" in executor._remedy({})
        assert lacking({MEMORY: 1e15}, executor._workers) is None
        [policy] = client.run(lambda: os.environ["OMP_WAIT_POLICY"]).values()
        executor.close()
    assert policy == "PASSIVE"


def test_other_users_of_this_machine_are_refused() -> None:
    with dask.config.set(SETTINGS), start_workers(1) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tls://")
        with Client(cluster, set_as_default=False) as owner:
            assert owner.submit(os.getpid).result(timeout=60) != os.getpid()
        for security in (None, Security.temporary()):
            with pytest.raises((OSError, TypeError)):
                Client(address, security=security, timeout="2s", set_as_default=False).close()


class Unprepared:
    """dask with workers that cannot be prepared."""

    def __init__(self, *anything: object, **more: object) -> None: ...

    def register_plugin(self, plugin: object, name: str) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def close(self, timeout: float) -> None: ...


@pytest.mark.parametrize(("address", "told"), [(None, False), ("127.0.0.1:8786", True)])
def test_a_fault_of_this_machine_is_not_told_as_one_of_a_cluster(
    monkeypatch: pytest.MonkeyPatch, address: str | None, told: bool
) -> None:
    for name in ("start_workers", "Client"):
        monkeypatch.setattr(cluster_module, name, Unprepared)
    with pytest.raises(CommandError) as refused:
        DaskExecutor(1, address)
    assert "found OSError: [Errno 28] No space left on device" in str(refused.value)
    assert [word in str(refused.value) for word in ("--scheduler", "PYTHONPATH")] == [told, told]
    assert "None" not in str(refused.value)


def test_a_run_waits_for_its_own_scheduler_where_others_take_the_cores(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This scheduler is a thread of the run's own process: on an overloaded machine, it may not answer for long."""
    executor = DaskExecutor(1)
    asked, silent = executor._asked, iter(range(3))
    monkeypatch.setattr(cluster_module, "SILENCE", 0.0)
    monkeypatch.setattr(cluster_module, "LOOK_EVERY", 0.01)
    monkeypatch.setattr(executor, "_asked", lambda: asked() if next(silent, None) is None else None)
    workspace.write("stages:\n  a: {uses: numbers}\n")
    assert workspace.run(executor=executor).states == {"a": "ran"}
    assert next(silent, None) is None


def test_a_run_waits_for_its_own_workers_to_be_started_again(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All may die at once where memory is short. If none comes back, other resources are of no help."""
    monkeypatch.setattr(cluster_module, "LOOK_EVERY", 0.01)
    workspace.write("stages:\n  a: {uses: numbers}\n")
    nobody: tuple[dict[str, object], dict[str, object]] = ({}, {})
    executor = DaskExecutor(1, patience=0.0)
    asked, without = executor._asked, iter(range(3))
    monkeypatch.setattr(executor, "_asked", lambda: asked() if next(without, None) is None else nobody)
    assert workspace.run(executor=executor).states == {"a": "ran"}
    assert next(without, None) is None
    monkeypatch.setattr(cluster_module, "SILENCE_HERE", 0.0)
    executor = DaskExecutor(1)
    monkeypatch.setattr(executor, "_asked", lambda: nobody)
    cause = str(workspace.run("a.count=4", executor=executor).ended["a"].cause)
    assert cause.startswith("needs a worker, but there is no worker. The worker processes of this run died")
    assert "--workers 1" in cause
    assert "--resources" not in cause


def test_where_closing_is_interrupted_nothing_is_waited_for_at_exit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Closing is interrupted by a second Ctrl-C. At exit, dask closes what is still open, for up to ten seconds."""
    started = []

    def starting(count: int) -> LocalCluster:
        started.append(start_workers(count))
        return started[0]

    def interrupted(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cluster_module, "start_workers", starting)
    monkeypatch.setattr(cluster_module, "_closed", interrupted)
    executor = DaskExecutor(1)
    before = multiprocessing.active_children()
    with pytest.raises(KeyboardInterrupt):
        executor.close()
    assert started[0].status == Status.running
    assert not started[0].shutdown_on_close
    assert before
    wait_until(lambda: not any(child.is_alive() for child in before), "workers to be killed")
    with suppress(TimeoutError):  # dask waits here for what nothing waits for at exit
        started[0].close(timeout=1)
