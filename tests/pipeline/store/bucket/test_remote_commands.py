"""`show`, `export`, `verify`, `gc`, `pin` and `accept` on a store in a bucket: what one machine does, others see."""

from __future__ import annotations

import importlib
import json
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("s3fs", reason='stores in a bucket are tested with pip install "gs-hider[dev]"')

from pipeline.artifact import load
from pipeline.cli import app
from pipeline.store.checksummed import with_checksum
from tests.pipeline.elsewhere import Elsewhere
from tests.pipeline.helpers import CHAIN, TOYS
from tests.pipeline.model import StageNode
from tests.pipeline.test_never_stale import Session, forget

DONE = dict.fromkeys(["base", "twice", "other", "sum"], "cached")


@pytest.fixture
def chain(remote: Elsewhere) -> Elsewhere:
    """Machine A ran it, and machine B is in use now."""
    remote.write(CHAIN).run()
    remote.machine("B")
    return remote


def call(remote: Elsewhere, command: str, *arguments: object, status: int = 0) -> str:
    """What a command prints on the machine in use."""
    words = [command, *map(str, arguments), "--store", remote.address]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == status, done.output or done.exception
    return done.output


def lines(said: str) -> list[dict[str, object]]:
    return [json.loads(line) for line in said.splitlines()]


def digest_of(remote: Elsewhere, name: str) -> str:
    return remote.store().latest_digests()[name]


def names(remote: Elsewhere, folder: str) -> set[str]:
    return set(remote.store()._bucket.names(folder))


def alter(remote: Elsewhere, name: str) -> None:
    """Flips a bit of an object in the bucket."""
    bucket = remote.store()._bucket
    data = bucket.get(name)
    assert data
    bucket.put(name, data[:-1] + bytes([data[-1] ^ 1]))


def test_show_by_name_and_digest(chain: Elsewhere) -> None:
    """Names are those of the last run on any machine; only what is shown is fetched."""
    (shown,) = lines(call(chain, "show", "chain/twice.numbers", "--json"))
    assert shown["names"] == ["chain/twice.numbers"]
    assert shown["arrays"][0]["range"] == {"least": 0.0, "mean": 2.0, "greatest": 4.0, "nan": 0, "infinite": 0}  # type: ignore[index]
    assert shown["origin"]["made_by"] == "chain/twice"  # type: ignore[index]
    assert [step["name"] for step in shown["origin"]["lineage"]] == ["base", "twice"]  # type: ignore[index]
    assert [path.name for path in (chain.store().root / "objects").iterdir()] == [shown["digest"]]
    chain.machine("C")
    assert lines(call(chain, "show", str(shown["digest"])[:8], "--json"))[0]["digest"] == shown["digest"]
    chain.machine("A").run("factor=3.0")
    (newer,) = lines(call(chain.machine("B"), "show", "chain/twice", "--json"))
    assert newer["arrays"][0]["range"]["greatest"] == 6.0  # type: ignore[index]
    assert "did you mean 'twice'" in call(chain, "show", "twise", status=2)
    assert f"{chain.address}: no artifact" in call(chain, "show", "twise", status=2)


def test_links_of_this_machine_do_not_hide_newer_results(chain: Elsewhere) -> None:
    chain.run()
    chain.machine("A").run("factor=3.0")
    assert chain.store().latest_digests() == chain.machine("B").store().latest_digests()


def test_export(chain: Elsewhere, tmp_path: Path) -> None:
    call(chain, "export", "chain/twice.numbers", tmp_path / "copy")
    copy = load(tmp_path / "copy")
    copy.verify()
    np.testing.assert_array_equal(copy.read("values"), [0.0, 2.0, 4.0])
    call(chain, "export", copy.digest[:10], tmp_path / "copy.zip")
    assert (tmp_path / "copy.zip").is_file()


def test_what_is_private_is_not_shown_elsewhere(remote: Elsewhere, tmp_path: Path) -> None:
    remote.write("name: hide\nstages:\n  photos: {uses: numbers, private: true, with: {first: 8128}}\n").run()
    remote.machine("B")
    assert "8128" not in call(remote, "show", "hide/photos.numbers")
    assert "8128" in call(remote, "show", "hide/photos.numbers", "--reveal")
    (tmp_path / ".git").mkdir()
    assert "git work tree" in call(remote, "export", "hide/photos", tmp_path / "copy", status=2)


def test_verify_reads_the_bucket(chain: Elsewhere) -> None:
    """On a machine without copies, damaged data is set aside, and the next run makes it again."""
    assert call(chain, "verify").startswith("Everything is sound: 6 artifacts, 4 records")
    assert not (chain.store().root / "objects").exists(), "nothing is left here"
    bucket = chain.store()._bucket
    altered, lacking, unnamed = (
        digest_of(chain, f"chain/{name}") for name in ("twice.numbers", "base.numbers", "other.numbers")
    )
    alter(chain, next(iter(bucket.names(f"files/{altered}"))))
    bucket.delete([next(iter(bucket.names(f"files/{lacking}")))])
    alter(chain, f"manifests/{unnamed}.json")
    dry = call(chain, "verify", "--dry-run", status=1).splitlines()
    assert f"artifact {altered[:12]} (chain/twice.numbers): " in "\n".join(dry)
    assert dry[:-1] == call(chain, "verify", "--dry-run", status=1).splitlines()[:-1]
    said = lines(call(chain, "verify", "--json", status=1))
    found = {(line["what"], line["name"]): str(line["cause"]) for line in said[:-1]}
    assert {name for what, name in found if what == "artifact"} == {altered, lacking, unnamed}
    assert "altered since it was written" in found["artifact", altered]
    assert "a file of this artifact is missing" in found["artifact", lacking]
    assert len([name for what, name in found if what == "record"]) == 3
    assert chain.machine("C").store().objects.isdisjoint({altered, lacking, unnamed})
    assert call(chain, "verify").startswith("Everything is sound: 3 artifacts, 1 record")
    assert chain.run().states == DONE | {"base": "ran", "twice": "ran", "other": "ran"}
    assert call(chain.machine("D"), "verify").startswith("Everything is sound: 6 artifacts, 4 records")


def test_a_sound_copy_takes_the_place_of_a_damaged_original(chain: Elsewhere) -> None:
    """The machine that made it still has it: nothing is lost."""
    digest = digest_of(chain, "chain/twice.numbers")
    key = str(chain.plan()["twice"].key)
    alter(chain, next(iter(chain.store()._bucket.names(f"files/{digest}"))))
    alter(chain, f"actions/{key}.json")
    said = call(chain.machine("A"), "verify", status=1)
    assert said.count("replaced by the sound copy on this machine") == 2
    assert call(chain.machine("C"), "verify").startswith("Everything is sound: 6 artifacts, 4 records")
    assert chain.run().states == DONE


def test_verify_of_a_record(chain: Elsewhere) -> None:
    key = str(chain.plan()["twice"].key)
    alter(chain, f"actions/{key}.json")
    chain.machine("C")
    assert f"record {key[:12]}: altered since it was written" in call(chain, "verify", status=1)
    assert f"actions/{key}.json" not in names(chain, "actions")
    assert call(chain, "verify").startswith("Everything is sound")
    assert chain.run().states == DONE | {"twice": "ran"}


def test_a_damaged_copy_is_no_damage_of_the_store(chain: Elsewhere) -> None:
    path = chain.run().artifact("twice").path
    next(path.glob("arrays.zarr/values/c/*")).write_bytes(b"")
    assert call(chain, "verify").startswith("Everything is sound")
    assert not path.exists()
    np.testing.assert_array_equal(chain.store().artifact(path.name).read("values"), [0.0, 2.0, 4.0])


def test_gc_spares_what_is_young(chain: Elsewhere) -> None:
    for factor in (3.0, 4.0):
        chain.run(f"factor={factor}")
    chain.store()._bucket.delete([min(names(chain, "actions"))])  # its machine has put the artifacts only, so far
    chain.store()._bucket.put(f"files/{'f' * 64}/{'e' * 64}", b"12345")  # another that is being put just now
    before = [names(chain, folder) for folder in ("actions", "manifests", "files")]
    said = call(chain, "gc", "--keep-last", "1")
    assert "what was stored within the last day" in said
    assert [names(chain, folder) for folder in ("actions", "manifests", "files")] == before


def test_gc_deletes_in_the_bucket(chain: Elsewhere, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.store.bucket.remote.SPARED", 0.0)
    monkeypatch.setattr("pipeline.store.garbage.JOURNALS_KEPT", 1)
    chain.write(
        "name: other\nstages:\n  lone: {uses: fail, with: {how: defect}, in: {numbers: base}}\n"
        "  base: {uses: numbers, with: {first: 70}}\n"
    ).run()
    chain.write(CHAIN).run("factor=3.0")
    bucket = chain.store()._bucket
    bucket.put(f"files/{'f' * 64}/{'e' * 64}", b"12345")  # an upload that broke off
    bucket.put(f"code/{'d' * 64}.json", b"{}")
    every = {folder: names(chain, folder) for folder in ("actions", "manifests", "files", "runs", "code", "logs")}
    arguments = ("gc", "--keep-last", "1", "--forget", "other")
    planned = call(chain, *arguments, "--json", "--dry-run")
    assert {folder: names(chain, folder) for folder in every} == every
    assert planned == call(chain, *arguments, "--json")
    stages = {
        line["stage"] for line in lines(planned) if line.get("what") == "artifacts" and line["workflow"] == "chain"
    }
    assert stages == {"twice", "sum"}
    assert len(names(chain, "actions")) == len(DONE)
    left = {name.split("/")[1] for name in names(chain, "files")}
    assert {f"manifests/{digest}.json" for digest in left} == names(chain, "manifests")
    assert not any("/other/" in name for name in names(chain, "runs") | names(chain, "logs"))
    assert len(names(chain, "runs")) == 1
    assert f"code/{'d' * 64}.json" not in names(chain, "code")
    assert names(chain, "code")
    chain.machine("C")
    assert chain.plan("factor=3.0")["sum"].state == "cached"
    assert chain.plan()["twice"].state != "cached"
    assert call(chain, "verify").startswith("Everything is sound")
    assert chain.machine("A").run().states == {"base": "cached", "twice": "ran", "other": "cached", "sum": "ran"}
    assert chain.is_valid()


@pytest.mark.parametrize("name", ["logs/../x", "runs/../../x.jsonl", "logs//x", "code/./x.json", "files/.."])
def test_names_that_lead_elsewhere(chain: Elsewhere, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Even those who can write to the bucket cannot delete anything on the machines that read it."""
    monkeypatch.setattr("pipeline.store.bucket.remote.SPARED", 0.0)
    chain.run()
    bucket = chain.store()._bucket
    bucket._call("put_object", Key=bucket._key(name), Body=b"?")
    root = chain.store().root
    strangers = [root.parent / "mine", root / "mine"]
    for path in strangers:
        path.write_text("mine")
    before = sorted((root / "objects").iterdir())
    assert "could lead elsewhere" in call(chain, "gc")
    assert sorted((root / "objects").iterdir()) == before
    assert [path.read_text() for path in strangers] == ["mine", "mine"]
    assert chain.run().states == DONE


def test_only_keys_and_digests_count(chain: Elsewhere) -> None:
    store = chain.store()
    actions, objects, workflows = store.actions, store.objects, store.history.workflows()
    for name in ("actions/x.json", f"actions/{'a' * 64}", f"manifests/{'A' * 64}.json", "manifests/a/b.json", "runs/x"):
        store._bucket.put(name, b"{}")
    assert (store.actions, store.objects, store.history.workflows()) == (actions, objects, workflows)


def test_a_record_with_paths_in_it_whose_checksum_is_right(chain: Elsewhere) -> None:
    store = chain.store()
    record = next(iter(store.records()))
    outputs = dict.fromkeys(record.outputs, "../../../x")
    content = {"key": record.key, "parts": record.parts, "outputs": outputs, "provenance": record.provenance}
    store._bucket.put(f"actions/{record.key}.json", with_checksum(content).encode())
    assert store.kept_record(record.key) is None


def test_gc_drops_copies_of_what_was_deleted_elsewhere(chain: Elsewhere, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.store.bucket.remote.SPARED", 0.0)
    chain.run("factor=3.0")
    call(chain, "gc", "--keep-last", "1")
    here = chain.machine("A").store()
    assert {path.name for path in (here.root / "objects").iterdir()} - here.objects
    call(chain, "gc", "--keep-last", "1")
    assert {path.name for path in (here.root / "objects").iterdir()} <= here.objects
    assert {path.name for path in (here.root / "actions").iterdir()} <= here.actions


def test_pins_live_in_the_bucket(chain: Elsewhere, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.store.bucket.remote.SPARED", 0.0)
    call(chain, "pin", chain.file, "--name", "paper", "--stages", TOYS)
    assert "there is already a pin 'paper'" in call(
        chain.machine("C"), "pin", chain.file, "--name", "paper", "--stages", TOYS, status=2
    )
    assert lines(call(chain, "pins", "--json"))[0] | {"made": ""} == {
        "event": "pin",
        "name": "paper",
        "workflow": "chain",
        "made": "",
        "results": 4,
        "present": 4,
    }
    chain.run("factor=3.0")
    call(chain, "gc", "--keep-last", "1")
    assert {step.state for step in chain.plan().values()} == {"cached"}
    chain.store()._bucket.put("pins/torn.json", b"{")
    assert f"{chain.address}/pins/torn.json: the pin cannot be read" in call(chain, "gc", status=2)
    assert "pin torn" in call(chain, "verify", status=1)
    for name in ("torn", "paper"):
        call(chain.machine("D"), "unpin", name)
    assert call(chain, "pins") == "Nothing is pinned.\n"
    call(chain.machine("C"), "gc", "--keep-last", "1")
    assert chain.plan()["twice"].state != "cached"


def test_what_is_private_on_another_machine(chain: Elsewhere) -> None:
    """Journals name stages, so only their owner can read them; pins leave nothing on this machine."""
    chain.run()
    call(chain, "pin", chain.file, "--stages", TOYS)
    call(chain, "pins")
    root = chain.store().root
    for path in (root, root / "runs", *(root / "runs").rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path
    assert not (root / "pins").exists()


class SessionElsewhere(Session):
    """A package of stages that can be edited, with its results in a bucket."""

    def __init__(self, remote: Elsewhere, nodes: list[StageNode]) -> None:
        super().__init__(remote.folder, nodes, [])
        remote.package = self.workspace.package
        self.workspace = remote


@pytest.fixture
def session(remote: Elsewhere, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    nodes = [StageNode("s0", "source", [], {"base": 2}), StageNode("s1", "transform", [0], {})]
    with SessionElsewhere(remote, nodes) as session:
        yield session


def prepare(session: Session) -> None:
    session.world.write()
    forget(session.world.package)
    importlib.invalidate_caches()


def test_what_is_accepted_is_accepted_everywhere(session: SessionElsewhere, remote: Elsewhere) -> None:
    prepare(session)
    assert set(remote.run().states.values()) == {"ran"}
    session.world.code["transform"].unused += 1
    prepare(session)
    remote.machine("B")
    assert remote.plan()["s1"].state == "run"
    said = call(remote, "accept", remote.file, "s1", "--stages", remote.package)
    assert said.startswith("s1: kept although code changed")
    remote.machine("C")
    assert {step.state for step in remote.plan().values()} == {"cached"}
    assert "although: code changed" in call(remote, "explain", remote.file, "s1", "--stages", remote.package)
    assert set(remote.run().states.values()) == {"cached"}
