"""What machines that share a bucket could lose by each other: keys and journals, and files by a stranger's journal."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("s3fs", reason='stores in a bucket are tested with pip install "gs-hider[dev]"')

from pipeline.errors import RemoteError
from pipeline.store.bucket.bucket import Bucket
from pipeline.store.checksummed import with_checksum
from pipeline.store.garbage import Rules, collect
from pipeline.store.verification import MENDED, verify_store
from tests.pipeline.elsewhere import Elsewhere

KEY = """
    name: hides
    stages:
      key: {uses: draw}
      use: {uses: scale, in: {numbers: key}}
    """


def test_a_key_that_is_sound_on_the_machine_that_drew_it(remote: Elsewhere, monkeypatch: pytest.MonkeyPatch) -> None:
    """`verify` elsewhere withdraws it from the bucket; `gc` here spares the copy, and `verify` here puts it back."""
    monkeypatch.setattr("pipeline.store.bucket.remote.SPARED", 0.0)
    ended = remote.write(KEY).run().ended["key"]
    digest, bucket = ended.outputs["numbers"].name, remote.store()._bucket
    bucket.put(min(bucket.names(f"files/{digest}")), b"damaged")
    remote.machine("B")
    assert [each.what for each in [*verify_store(remote.store())] if each.irreplaceable] == ["artifact"]
    store = remote.machine("A").store()
    assert remote.run().states["key"] == "failed"
    with store.in_use(alone=True):
        collect(store, Rules()).delete()
    told = [each for each in verify_store(store) if each.damage]
    assert [(each.what, each.name, str(each.damage).endswith(MENDED)) for each in told] == [("record", ended.key, True)]
    assert remote.machine("B").run().states["key"] == "cached"
    assert remote.machine("A").run().states["key"] == "cached"


def test_a_key_that_was_given_up_does_not_come_back(remote: Elsewhere) -> None:
    """The message about a lost one says: delete its record, and the next run makes a new one."""
    ended = remote.write(KEY).run().ended["key"]
    remote.store()._bucket.delete([f"actions/{ended.key}.json"])
    anew = remote.run().ended["key"]
    assert anew.state == "ran"
    assert anew.outputs["numbers"].name != ended.outputs["numbers"].name


def test_a_journal_that_is_deleted_meanwhile_hides_no_other(remote: Elsewhere, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another machine's `gc` may delete an old one between being listed and fetched."""
    bucket = remote.store()._bucket
    names = [f"runs/w/202601{day:02d}T000000.000000Z-00000000.jsonl" for day in range(1, 13)]
    for name in names:
        bucket.put(name, b"{}\n")
    history = remote.machine("B").store().history
    listing, deleted = type(bucket).names, []

    def listed(own: Bucket, folder: str) -> dict[str, int]:
        found = listing(own, folder)
        if folder == "runs/w" and not deleted:
            deleted.append(min(found))
            own.delete(deleted)
        return dict(found)

    monkeypatch.setattr(Bucket, "names", listed)
    assert [path.name for path in history.journals("w")] == [name.rpartition("/")[2] for name in reversed(names[1:])]


def test_journals_that_are_listed_and_not_there_are_told(remote: Elsewhere, monkeypatch: pytest.MonkeyPatch) -> None:
    remote.store()
    monkeypatch.setattr(Bucket, "names", lambda bucket, folder: {"runs/w/1.jsonl": 3})
    with pytest.raises(RemoteError, match="runs/w: journals that the bucket lists are not there"):
        remote.store().history.journals("w")


def test_a_journal_of_a_stranger_leads_nowhere(remote: Elsewhere, tmp_path: Path) -> None:
    """Keys name folders, so that what is no key, such as an absolute path, must not count as one."""
    remote.write(KEY)
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "record.json").write_text("precious")
    facts = {"started": "2026-01-01T00:00:00+00:00", "seconds": 1.0, "versions": {}, "machine": {}, "facts": {}}
    record = {"key": str(victim), "parts": {}, "outputs": {}, "provenance": {**facts, "private": False}}
    result = {"name": "key", "state": "ran", "key": str(victim), "outputs": {"numbers": 64 * "0"}}
    bucket = remote.store()._bucket
    bucket.put(f"actions/{victim}.json", with_checksum(record).encode())
    bucket.put("runs/hides/20260101T000000.000000Z-00000000.jsonl", f"{json.dumps(result)}\n".encode())
    assert remote.plan()["key"].state == "run"
    assert remote.store().record(str(victim)) is None
    assert (victim / "record.json").read_text() == "precious"
