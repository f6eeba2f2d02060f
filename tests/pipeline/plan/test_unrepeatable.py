"""What was drawn once and cannot be drawn again is never replaced, unless a person gives it up."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.errors import CorruptArtifact
from pipeline.store.garbage import Rules, collect
from pipeline.store.store import Store
from pipeline.store.verification import verify_store
from tests.pipeline.helpers import TOYS, Ran, Workspace

if TYPE_CHECKING:
    from tests.pipeline.elsewhere import Elsewhere

DRAWN = """
    name: drawn
    stages:
      key:  {uses: draw}
      hide: {uses: scale, in: {numbers: key}}
      more: {uses: scale, in: {numbers: hide}}
    """


@pytest.fixture
def drawn(workspace: Workspace) -> Ran:
    return workspace.write(DRAWN).run()


def cut(ran: Ran) -> None:
    path = ran.ended["key"].outputs["numbers"] / "arrays.zarr/values/zarr.json"
    path.write_bytes(path.read_bytes()[:-1])


def flip(ran: Ran) -> None:
    path = ran.ended["key"].outputs["numbers"] / "arrays.zarr/values/c/0"
    data = path.read_bytes()
    path.write_bytes(bytes([data[0] ^ 1]) + data[1:])


def damage_record(ran: Ran) -> None:
    (ran.project.store.root / "actions" / str(ran.ended["key"].key) / "record.json").write_text("{")


def verify(ran: Ran) -> list[str]:
    return [str(checked.damage) for checked in verify_store(ran.project.store) if checked.damage]


def remove(ran: Ran) -> None:
    shutil.rmtree(ran.ended["key"].outputs["numbers"])


def flip_and_verify(ran: Ran) -> None:
    flip(ran)
    assert verify(ran)


@pytest.mark.parametrize("verified", [False, True])
@pytest.mark.parametrize("damage", [cut, flip, damage_record])
def test_it_is_not_drawn_again(workspace: Workspace, drawn: Ran, damage: Callable[[Ran], None], verified: bool) -> None:
    key = drawn.ended["key"]
    shutil.copytree(drawn.project.store.root, workspace.folder / "copy", symlinks=True)
    damage(drawn)
    if verified:
        assert verify(drawn)
    for _ in range(2):
        again = workspace.run("hide.factor=3.0")
        assert again.states == {"key": "failed", "hide": "skipped", "more": "skipped"}
    cause = str(again.ended["key"].cause)
    assert "the result of key is damaged or missing, and no run can make the same one; made from it: hide" in cause
    assert str(drawn.project.store.damaged.folder) in cause
    hidden = drawn.ended["hide"].outputs["numbers"].name
    assert f"hide.numbers ({hidden[:12]}); `export` takes their digests" in cause, "it is not lost with the key"
    for name in (f"objects/{key.outputs['numbers'].name}", f"actions/{key.key}"):
        shutil.rmtree(workspace.folder / "store" / name, ignore_errors=True)
        shutil.copytree(workspace.folder / "copy" / name, workspace.folder / "store" / name)
    assert workspace.run("hide.factor=3.0").states["key"] == "cached", "it was put back from a copy"


def test_who_gives_it_up_gets_another(workspace: Workspace, drawn: Ran) -> None:
    before = drawn.values("key")
    cut(drawn)
    verify(drawn)
    cause = str(workspace.run().ended["key"].cause)
    (remains,) = drawn.project.store.remains(str(drawn.ended["key"].key))
    assert f"delete {remains}" in cause
    shutil.rmtree(remains)
    again = workspace.run()
    assert set(again.states.values()) == {"ran"}
    assert not np.array_equal(again.values("key"), before)


@pytest.mark.parametrize("lose", [cut, remove, damage_record, flip_and_verify])
def test_what_a_run_refuses_is_told_before(workspace: Workspace, drawn: Ran, lose: Callable[[Ran], None]) -> None:
    lose(drawn)
    steps = workspace.plan()
    assert (steps["key"].state, steps["key"].key) == ("lost", drawn.ended["key"].key)
    assert steps["hide"].reasons == ("input numbers waits for key",)
    where = (str(workspace.file), "--stages", TOYS, "--store", str(workspace.folder / "store"))
    status, dry, explained = (
        CliRunner().invoke(app, [command, *where, *more]).stdout
        for command, *more in (("status",), ("run", "--dry-run"), ("explain", "key"))
    )
    refusal = str(workspace.run().ended["key"].cause)
    assert status.splitlines()[0] == f"key   lost  {refusal}"
    assert "1 lost" in status
    assert dry == status
    assert explained == f"key: lost\n  {refusal}\n"
    of_key_alone = str(workspace.run(stages=["key"]).ended["key"].cause)
    assert "made from it: nothing in this part of the workflow" in of_key_alone
    assert workspace.plan("key.seed=1")["key"].state == "run", "what anybody can draw again is not lost"


def test_what_was_given_up_is_to_run(workspace: Workspace, drawn: Ran) -> None:
    cut(drawn)
    for path in drawn.project.store.remains(str(drawn.ended["key"].key)):
        shutil.rmtree(path)
    assert workspace.plan()["key"].state == "run"


def test_what_has_a_seed_is_drawn_again(workspace: Workspace) -> None:
    ran = workspace.write(DRAWN).run("key.seed=1")
    before = ran.values("key")
    cut(ran)
    with pytest.raises(CorruptArtifact):
        ran.values("key")
    again = workspace.run("key.seed=1")
    assert again.states == {"key": "ran", "hide": "cached", "more": "cached"}
    np.testing.assert_array_equal(again.values("key"), before)


def test_verify_says_so(drawn: Ran) -> None:
    cut(drawn)
    assert "it cannot be made again" in verify(drawn)[0]


def test_the_last_line_of_verify_promises_no_other_one(workspace: Workspace, drawn: Ran) -> None:
    """The artifact, its record and its link are one loss, and are counted apart."""
    cut(drawn)
    said = CliRunner().invoke(app, ["verify", "--store", str(workspace.folder / "store")]).stdout.splitlines()[-1]
    assert said.startswith("1 artifact, 1 record, 1 link damaged, of 3 artifacts")
    assert said.endswith("; the next run remakes what it needs, but not what cannot be made again")


def test_gc_keeps_what_is_left_of_it(workspace: Workspace, drawn: Ran) -> None:
    """Although no run needs it any more: what was published may need it."""
    cut(drawn)
    verify(drawn)
    workspace.write("name: drawn\nstages:\n  other: {uses: numbers}\n").run()
    store = Store(workspace.folder / "store")
    collect(store, Rules(keep_last=1)).delete()
    assert [path.name for path in store.root.glob("damaged/*/*") if path.name != "record.json"]
    assert workspace.write(DRAWN).run().states["key"] == "failed"


def test_gc_keeps_what_is_left_of_each_of_several(workspace: Workspace, drawn: Ran, tmp_path: Path) -> None:
    """The first was given up, and its replacement is damaged, too; then the first comes back from a copy."""
    store = drawn.project.store
    record = store.damaged.folder / "actions" / str(drawn.ended["key"].key)
    cut(drawn)
    verify(drawn)
    record.rename(tmp_path / "kept")
    again = workspace.run()
    cut(again)
    verify(again)
    (tmp_path / "kept").rename(record.with_name(f"{record.name}.2"))
    workspace.write("name: drawn\nstages:\n  other: {uses: numbers}\n").run()
    collect(store, Rules(keep_last=1)).delete()
    assert {path.name for path in record.parent.iterdir()} == {record.name, f"{record.name}.2"}
    drawn_keys = {ran.ended["key"].outputs["numbers"].name for ran in (drawn, again)}
    assert {path.name for path in store.root.glob("damaged/objects/*")} >= drawn_keys


def test_to_say_so_changes_no_key(tmp_path: Path) -> None:
    """Otherwise, the declaration that protects a key would itself have a new one drawn."""
    from pipeline.code.fingerprint import read_module

    text = (Path(__file__).parents[1] / "toys/draw.py").read_text()
    note = "    unrepeatable=lambda given: given.seed is None,\n"
    text = text.replace(note, f'{note}    unread={{"of": {{"seed": 0}}}},\n')
    note = text[text.index(note) : text.index(")\ndef draw")]
    assert note in text
    files = [tmp_path / name for name in ("with.py", "without.py", "other.py")]
    for file, content in zip(
        files, (text, text.replace(note, ""), text.replace("randbits(64)", "randbits(32)")), strict=True
    ):
        file.write_text(content)
    said, unsaid, other = (read_module("draw", file).digest for file in files)
    assert said == unsaid != other


def test_after_a_change_of_code_alone_it_is_accepted(
    workspace: Workspace, drawn: Ran, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new version of this program must not draw another key, with which what was published could not be read."""
    monkeypatch.setattr("pipeline.plan.keys.FORMAT", 3)
    again = workspace.run()
    assert again.states == {"key": "failed", "hide": "skipped", "more": "skipped"}
    assert "only the code of key changed" in str(again.ended["key"].cause)
    step = workspace.plan()["key"]
    assert (step.state, step.reasons) == ("refused", (again.ended["key"].cause,))
    where = ["--store", str(workspace.folder / "store"), "--stages", TOYS]
    assert CliRunner().invoke(app, ["accept", str(workspace.file), "key", *where]).exit_code == 0
    kept = workspace.run()
    assert kept.states == {"key": "cached", "hide": "ran", "more": "ran"}
    assert kept.ended["key"].outputs["numbers"].name == drawn.ended["key"].outputs["numbers"].name


@pytest.mark.parametrize("renamed", [False, True])
def test_after_a_change_of_code_it_is_kept_though_the_last_run_was_of_something_else(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch, renamed: bool
) -> None:
    """Pair A is hidden, then pair B, then a new version comes: A's key is not drawn anew without asking."""
    told = "name: {}\nvars: {{n: 3}}\nstages:\n  photos: {{uses: numbers, with: {{count: '${{n}}'}}}}\n  {}"
    key = "key: {uses: draw, in: {of: photos}}\n"
    first = workspace.write(told.format("drawn", key)).run("n=3")
    workspace.run("n=4")
    if renamed:
        workspace.write(told.format("another", f"other_{key}"))
    name = "other_key" if renamed else "key"
    monkeypatch.setattr("pipeline.plan.keys.FORMAT", 3)
    where = ["--store", str(workspace.folder / "store"), "--stages", TOYS, "--set", "n=3"]
    if not renamed:
        assert workspace.plan("n=3")["photos"].changes, "only its code"
        assert {change.part for change in workspace.plan("n=3")["photos"].changes} <= {"format"}
    again = workspace.run("n=3")
    assert again.states[name] == "failed"
    assert f"only the code of {name} changed" in str(again.ended[name].cause)
    assert workspace.plan("n=3")[name].state == "refused"
    done = CliRunner().invoke(app, ["accept", str(workspace.file), name, *where])
    assert done.exit_code == 0, done.output
    kept = workspace.run("n=3")
    assert kept.states[name] == "cached"
    assert kept.ended[name].outputs["numbers"].name == first.ended["key"].outputs["numbers"].name


def test_after_a_change_of_code_another_is_drawn_on_purpose(
    workspace: Workspace, drawn: Ran, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.plan.keys.FORMAT", 3)
    record = drawn.project.store.root / "actions" / str(drawn.ended["key"].key)
    assert f"delete {record}" in str(workspace.run().ended["key"].cause)
    shutil.rmtree(record)
    again = workspace.run()
    assert again.states["key"] == "ran"
    assert again.ended["key"].outputs["numbers"].name != drawn.ended["key"].outputs["numbers"].name


@pytest.mark.parametrize("verified", [False, True])
def test_in_a_bucket(remote: Elsewhere, monkeypatch: pytest.MonkeyPatch, verified: bool) -> None:
    """On a machine without a copy: what is left in the bucket tells all machines that there was one."""
    monkeypatch.setattr("pipeline.store.bucket.remote.SPARED", 0.0)
    digest = remote.write(DRAWN).run().ended["key"].outputs["numbers"].name
    bucket = remote.store()._bucket
    files = bucket.names(f"files/{digest}")
    bucket.put(next(iter(files)), b"?")
    store = remote.machine("B").store()
    if verified:
        assert [checked for checked in verify_store(store) if checked.damage]
        collect(store, Rules()).delete()
    assert remote.machine("C").run("hide.factor=3.0").states["key"] == "failed"
    assert bucket.names(f"files/{digest}").keys() == files.keys(), "what is whole of it is not deleted"


def test_in_a_bucket_gc_keeps_what_is_left_of_it(remote: Elsewhere, monkeypatch: pytest.MonkeyPatch) -> None:
    """Although no run needs it any more, and whichever machine found it damaged."""
    monkeypatch.setattr("pipeline.store.bucket.remote.SPARED", 0.0)
    digest = remote.write(DRAWN).run().ended["key"].outputs["numbers"].name
    bucket = remote.store()._bucket
    bucket.put(next(iter(bucket.names(f"files/{digest}"))), b"?")
    assert [checked for checked in verify_store(remote.machine("B").store()) if checked.damage]
    remote.write("name: drawn\nstages:\n  other: {uses: numbers}\n").run()
    collect(remote.store(), Rules(keep_last=1)).delete()
    assert remote.write(DRAWN).machine("C").run().states["key"] == "failed"
