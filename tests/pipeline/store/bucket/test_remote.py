"""Stores in a bucket, against a server process on loopback: other machines, two at once, kills, damage, no access."""

from __future__ import annotations

import json
import os
import signal
import stat
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("s3fs", reason='stores in a bucket are tested with pip install "gs-hider[dev]"')

import fsspec

from pipeline.errors import CommandError, CorruptArtifact, RemoteError, Unreachable
from pipeline.plan.plan import make_plan
from pipeline.store.bucket.bucket import Bucket
from pipeline.store.opening import open_store
from tests.pipeline.elsewhere import SECRET, Elsewhere, Server, await_file, forget_connections
from tests.pipeline.helpers import CHAIN, Ran

PAIR = """
    name: pair
    stages:
      base:  {uses: numbers}
      twice: {uses: scale, in: {numbers: base}}
    """
DONE = dict.fromkeys(["base", "twice", "other", "sum"], "cached")


def test_another_machine_finds_everything_done(remote: Elsewhere, server: Server) -> None:
    remote.write(CHAIN)
    first = remote.run()
    assert set(first.states.values()) == {"ran"}
    assert server.requests
    remote.machine("B")
    assert {name: step.state for name, step in remote.plan().items()} == DONE
    assert len(server.requests) == 4, "three listings and a journal"
    second = remote.run()
    assert second.states == DONE
    np.testing.assert_array_equal(second.values("sum", "total"), [6.0, 15.0])
    assert second.project.store.root != first.project.store.root
    assert not second.project.store.object(second.ended["twice"].outputs["numbers"].name).exists(), "not asked for"
    assert remote.run("factor=3.0").states == {"base": "cached", "twice": "ran", "other": "cached", "sum": "ran"}
    assert remote.machine("A").run("factor=3.0").states == DONE


def test_a_page_of_a_listing_is_not_all(remote: Elsewhere, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.store.bucket.bucket.PAGE", 3)
    (tmp_path / "empty").touch()
    store = remote.store()
    keys = {f"{number:064x}" for number in range(7)}
    store._bucket.upload({f"actions/{key}.json": tmp_path / "empty" for key in keys})
    assert store.actions == keys
    store._bucket.delete(store._bucket.names("actions"))
    assert store.actions == frozenset()


def test_what_is_private_stays_private(remote: Elsewhere, server: Server) -> None:
    remote.write(CHAIN + "  bad: {uses: fail, in: {numbers: base}, with: {how: defect}}\n").run()
    ran = remote.machine("B").run()
    artifact = ran.artifact("sum", "key")
    assert artifact.private
    for path in (artifact.path, *artifact.path.rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600)
    assert stat.S_IMODE(ran.project.store.root.stat().st_mode) == 0o700
    bucket = remote.store()._bucket
    names = [name for folder in ("actions", "manifests", "files", "runs", "logs") for name in bucket.names(folder)]
    assert "logs/chain/bad.log" in names
    for name in names:
        grants = bucket._call("get_object_acl", Key=bucket._key(name))["Grants"]
        assert all(grant["Grantee"]["Type"] == "CanonicalUser" for grant in grants), "its owner's alone"
        assert SECRET.encode() not in (bucket.get(name) or b"")
    for path in remote.folder.rglob("*"):
        assert not path.is_file() or SECRET.encode() not in path.read_bytes()


def test_of_two_writers_at_once_one_succeeds(remote: Elsewhere) -> None:
    buckets = [Bucket(remote.address) for _ in range(2)]
    for turn in range(10):
        barrier = threading.Barrier(2)
        succeeded: list[int] = []

        def write(writer: int, name: str, barrier: threading.Barrier, succeeded: list[int]) -> None:
            barrier.wait()
            if buckets[writer].create(name, str(writer).encode()):
                succeeded.append(writer)

        threads = [
            threading.Thread(target=write, args=(writer, f"actions/{turn}", barrier, succeeded)) for writer in (0, 1)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(succeeded) == 1
        assert buckets[0].get(f"actions/{turn}") == str(succeeded[0]).encode()


def test_two_runs_at_once_on_two_machines(remote: Elsewhere) -> None:
    """One has dask's workers, the other is one process; both succeed, and each action has one record."""
    remote.write(CHAIN)
    runs = [remote.start("--workers", "2", machine="A"), remote.start("--serial", machine="B")]
    ended = [run.communicate(timeout=100) for run in runs]
    assert [run.returncode for run in runs] == [0, 0], ended
    lines = [[json.loads(line) for line in out.splitlines()] for out, _ in ended]
    keys = [{line["key"] for line in said[:-1]} for said in lines]
    assert keys[0] == keys[1] == remote.store().actions
    assert remote.machine("C").run().states == DONE
    assert remote.is_valid()


def test_the_second_takes_the_record_of_the_first(remote: Elsewhere) -> None:
    """If results differ by chance, one of them counts, everywhere."""
    from tests.pipeline.store.test_store import KEY, commit

    first = commit(remote.machine("A").store(), 1.0)
    second = commit(remote.machine("B").store(), 2.0)
    assert second == first == remote.machine("C").store().find(KEY)
    np.testing.assert_array_equal(remote.store().artifact(second.outputs["out"]).read("values"), np.ones(3))


def killed_while_it_puts(remote: Elsewhere, server: Server, puts: int) -> None:
    (server.folder / "hold").write_text(str(puts))
    process = remote.start("--serial")
    await_file(server.folder / "held", process)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    (server.folder / "hold").unlink()
    (server.folder / "held").unlink()


def check_kills(remote: Elsewhere, server: Server, moments: list[int]) -> None:
    remote.write(CHAIN)
    for puts in moments:
        killed_while_it_puts(remote, server, puts)
        assert remote.is_valid()
    assert set(remote.machine("B").run().states.values()) <= {"ran", "cached"}
    assert remote.machine("C").run().states == DONE
    assert remote.is_valid()


def test_killed_while_it_puts(remote: Elsewhere, server: Server) -> None:
    """In the middle of an artifact's files; before its manifest; before its record."""
    check_kills(remote, server, [3, 4, 6])


@pytest.mark.slow
def test_killed_at_every_put(remote: Elsewhere, server: Server) -> None:
    """At every upload of a run that makes everything, the journal's last; then at some of a run that resumes."""
    assert server.requests
    remote.write(CHAIN).run()
    puts = sum(request.startswith("PUT ") for request in server.requests)
    address = remote.address
    for number in range(puts):
        remote.address = f"{address}/{number}"
        check_kills(remote, server, [number])
    remote.address = f"{address}/again"
    check_kills(remote, server, [9, 2, 8, 0, 5])


@pytest.mark.parametrize("damage", ["altered", "shortened", "missing", "no manifest", "not a manifest"])
def test_a_damaged_artifact_is_made_again(remote: Elsewhere, damage: str) -> None:
    digest = remote.write(PAIR).run().ended["base"].outputs["numbers"].name
    bucket = remote.store()._bucket
    name = next(iter(bucket.names(f"files/{digest}"))) if "manifest" not in damage else f"manifests/{digest}.json"
    data = bucket.get(name)
    assert data
    if damage in ("missing", "no manifest"):
        bucket.delete([name])
    else:
        bucket.put(name, data[:-1] if damage == "shortened" else bytes([data[0] ^ 1]) + data[1:])
    assert remote.machine("B").run("twice.factor=7").states == {"base": "ran", "twice": "ran"}
    assert remote.machine("C").run("twice.factor=8").states == {"base": "cached", "twice": "ran"}
    assert remote.is_valid()


def test_the_manifest_of_another_artifact_is_no_manifest(remote: Elsewhere) -> None:
    """Whoever can write to the bucket could otherwise exchange results."""
    ran = remote.write(PAIR).run()
    base, twice = (ran.ended[name].outputs["numbers"].name for name in ("base", "twice"))
    bucket = remote.store()._bucket
    other = bucket.get(f"manifests/{twice}.json")
    assert other
    bucket.put(f"manifests/{base}.json", other)
    with pytest.raises(CorruptArtifact, match=f"the manifest of another artifact, {twice}"):
        remote.machine("B").store().artifact(base)


def test_a_damaged_copy_is_fetched_again(remote: Elsewhere) -> None:
    path = remote.write(PAIR).run().artifact("base").path
    chunk = next(path.glob("arrays.zarr/values/c/*"))
    chunk.write_bytes(bytes([chunk.read_bytes()[0] ^ 1]) + chunk.read_bytes()[1:])
    assert remote.run("twice.factor=7").states["base"] == "cached"
    next(path.glob("arrays.zarr/values/c/*")).unlink()
    assert remote.run("twice.factor=8").states["base"] == "cached"


def test_a_damaged_record_is_written_again(remote: Elsewhere) -> None:
    key = remote.write(PAIR).run().ended["base"].key
    remote.store()._bucket.put(f"actions/{key}.json", b"{")
    assert remote.machine("B").run("twice.factor=7").states["base"] == "ran"
    assert remote.machine("C").run().states["base"] == "cached"


def test_what_is_deleted_is_deleted_everywhere(remote: Elsewhere) -> None:
    ran = remote.write(CHAIN).run()
    store = remote.machine("B").store()
    store.delete_record(str(ran.ended["base"].key))
    store.delete_object(ran.ended["base"].outputs["numbers"].name)
    assert not store._bucket.names(f"files/{ran.ended['base'].outputs['numbers'].name}")
    states = remote.machine("A").run().states
    assert states == {"base": "ran", "twice": "cached", "other": "cached", "sum": "cached"}
    assert remote.is_valid()


def test_a_broken_connection(remote: Elsewhere, server: Server) -> None:
    """After some attempts the stage fails, and nothing of its result is visible until all of it is uploaded."""
    (server.folder / "break").write_text("2")
    assert set(remote.write(CHAIN).run().states.values()) == {"ran"}
    (server.folder / "break").write_text("1000")
    ran = remote.run("base.count=4", retries=0)
    assert ran.states == {"base": "failed", "twice": "skipped", "other": "skipped", "sum": "skipped"}
    assert str(ran.ended["base"].cause).startswith(f"{remote.address}: the server cannot be reached; found ")
    assert len(remote.store().actions) == 4
    assert remote.machine("B").plan("base.count=4")["base"].failed == ran.ended["base"].cause
    (server.folder / "break").unlink()
    assert not remote.machine("A").store().abandoned()
    states = remote.run("base.count=4").states
    assert states == {"base": "cached", "twice": "ran", "other": "ran", "sum": "ran"}
    assert set(remote.machine("B").run("base.count=4").states.values()) == {"cached"}
    assert remote.is_valid()


def test_what_is_done_but_not_put_is_put_by_the_next_attempt(remote: Elsewhere, server: Server) -> None:
    """And not done again, unless any machine has deleted it from the bucket meanwhile."""
    (server.folder / "break").write_text("1000")
    remote.write(PAIR).run(retries=0)
    (server.folder / "break").unlink()
    assert remote.run().states == {"base": "cached", "twice": "ran"}
    store = remote.machine("B").store()
    store.delete_record(str(remote.machine("A").run().ended["base"].key))
    assert remote.run().states["base"] == "ran"


@pytest.fixture
def access(remote: Elsewhere) -> Iterator[pytest.MonkeyPatch]:
    """For environments with other credentials: the next test does not reuse connections made with them."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        yield monkeypatch
    forget_connections()


def plan(remote: Elsewhere) -> None:
    project = remote.open()
    make_plan(project.graph, project.store)


def test_what_goes_wrong_is_said_in_one_line(remote: Elsewhere, server: Server, access: pytest.MonkeyPatch) -> None:
    remote.write(CHAIN)
    (server.folder / "deny").touch()
    with pytest.raises(RemoteError, match=r"access denied; found AccessDenied. Check which credentials") as denied:
        plan(remote)
    assert SECRET not in str(denied.value)
    (server.folder / "deny").unlink()
    good, remote.address = remote.address, "s3://no-such-bucket/store"
    with pytest.raises(RemoteError, match=r"s3://no-such-bucket/store: there is no such bucket\. Create it, or"):
        plan(remote)
    with pytest.raises(RemoteError, match=r"there is no such bucket"):
        remote.run()
    remote.address = good
    access.delenv("AWS_ACCESS_KEY_ID")
    forget_connections()
    with pytest.raises(RemoteError, match=r"no credentials for the bucket; .*AWS_PROFILE"):
        plan(remote)
    access.setenv("AWS_ACCESS_KEY_ID", "reader")
    access.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    forget_connections()
    with pytest.raises(Unreachable, match=r"cannot be reached.*AWS_ENDPOINT_URL"):
        plan(remote)


@pytest.mark.parametrize("address", ["s3://", "s3://UPPER", "gs://bucket/a", "s3://bucket//a", "s3://bucket/a b"])
def test_addresses_that_are_none(address: str) -> None:
    with pytest.raises(CommandError, match=r"expected a folder or s3://BUCKET/PREFIX"):
        open_store(address)


def test_an_address_holds_no_credentials() -> None:
    with pytest.raises(CommandError, match=r"must not contain credentials") as told:
        open_store(f"s3://reader:{SECRET}@bucket/a")
    assert SECRET not in str(told.value)


@pytest.mark.parametrize("access", ["public-read", "public-read-write", "authenticated-read"])
def test_a_configuration_that_makes_objects_public_is_refused(
    remote: Elsewhere, monkeypatch: pytest.MonkeyPatch, access: str
) -> None:
    forget_connections()
    with monkeypatch.context() as configured:
        configured.setitem(fsspec.config.conf, "s3", {"s3_additional_kwargs": {"ACL": access}})
        with pytest.raises(CommandError, match=f"would make private results public; found ACL '{access}'"):
            remote.store()._bucket.put("pins/paper.json", b"{}")
    forget_connections()


def test_without_s3fs(remote: Elsewhere, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "s3fs", None)
    with pytest.raises(CommandError, match=r'pip install "gs-hider\[s3\]"'):
        plan(remote.write(CHAIN))


def test_results_shown_are_here(remote: Elsewhere) -> None:
    """The paths of what the last stages made are those of copies that exist."""
    remote.write(CHAIN).run()
    ran: Ran = remote.machine("B").run()
    assert all(path.is_dir() for path in ran.ended["sum"].outputs.values())
    assert all(path.exists() for path in ran.project.store.root.glob("latest/chain/sum.*"))
