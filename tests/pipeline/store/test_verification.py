"""`verify`: every kind of damage is found, named and set aside, and the next run makes again what was lost."""

from __future__ import annotations

import json
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.store.checksummed import CHECKSUM, with_checksum
from pipeline.store.store import Store
from pipeline.store.verification import Checked, verify_store
from tests.pipeline.helpers import CHAIN, Workspace


def damaged(store: Store, dry_run: bool = False) -> list[Checked]:
    return [checked for checked in verify_store(store, dry_run) if checked.damage]


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def chunk(artifact: Path) -> Path:
    return next(artifact.glob("arrays.zarr/values/c/*"))


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "flipped byte": (lambda artifact: flip(chunk(artifact)), "arrays.zarr/values/c/0: altered since it was written"),
    "deleted chunk": (lambda artifact: chunk(artifact).unlink(), "arrays.zarr/values/c/0: missing"),
    "shortened chunk": (
        lambda artifact: chunk(artifact).write_bytes(b"x"),
        "arrays.zarr/values/c/0: 1 bytes; expected",
    ),
    "truncated manifest": (
        lambda artifact: (artifact / "manifest.json").write_text((artifact / "manifest.json").read_text()[:99]),
        "manifest.json: not a manifest",
    ),
    "no manifest": (lambda artifact: (artifact / "manifest.json").unlink(), "no readable manifest.json"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_artifact(workspace: Workspace, damage: str) -> None:
    ran = workspace.write(CHAIN).run()
    store = ran.project.store
    assert damaged(store) == []
    artifact = ran.ended["twice"].outputs["numbers"]
    harm, words = DAMAGES[damage]
    harm(artifact)
    found = damaged(store, dry_run=True)
    assert [(checked.what, checked.stages) for checked in found] == [
        ("artifact", ("chain/twice.numbers",)),
        ("record", ("chain/twice",)),
        ("link", ()),
    ]
    assert words in str(found[0].damage)
    assert str(store.root) not in str(found[0].damage), "in few words"
    assert damaged(store) == found, "a dry run changes nothing"
    assert damaged(store) == [], "what is damaged is set aside"
    again = workspace.run()
    assert again.states == {"base": "cached", "twice": "ran", "other": "cached", "sum": "cached"}
    assert again.ended["twice"].outputs == ran.ended["twice"].outputs
    assert damaged(store) == []


@pytest.mark.parametrize("name", [".DS_Store", "arrays.zarr/values/c/7", "new/._file"])
def test_a_foreign_file_costs_no_artifact(workspace: Workspace, name: str) -> None:
    ran = workspace.write(CHAIN).run()
    store = ran.project.store
    artifact = ran.ended["twice"].outputs["numbers"]
    (artifact / name).parent.mkdir(exist_ok=True)
    (artifact / name).write_text("?")
    found = damaged(store, dry_run=True)
    assert [(checked.what, checked.name) for checked in found] == [("foreign file", f"{artifact.name}/{name}")]
    assert damaged(store) == found
    assert (store.damaged.folder / "foreign" / artifact.name / name).read_text() == "?"
    assert damaged(store) == []
    assert set(workspace.run().states.values()) == {"cached"}


def test_what_is_damaged_is_kept_where_nobody_else_can_enter(workspace: Workspace) -> None:
    """Also if it is damaged again: a small defect is no reason to throw away what may exist only once."""
    ran = workspace.write(CHAIN).run()
    artifact = ran.ended["twice"].outputs["numbers"]
    for _ in range(2):
        flip(chunk(artifact))
        damaged(Store(ran.project.store.root))
        workspace.run()
    aside = ran.project.store.damaged.folder
    assert stat.S_IMODE(aside.stat().st_mode) == 0o700
    assert {path.name for path in (aside / "objects").iterdir()} == {artifact.name, f"{artifact.name}.2"}
    assert all((path / "manifest.json").is_file() for path in (aside / "objects").iterdir())
    key = str(ran.ended["twice"].key)
    assert {path.name for path in (aside / "actions").iterdir()} == {key, f"{key}.2"}


def edit(file: Path, change: Callable[[dict[str, dict[str, object]]], object]) -> None:
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content["parts"].update(version=2),
        lambda content: content["provenance"].update(seconds=1e9),
        lambda content: content["outputs"].update(numbers="f" * 64),
        lambda content: content.pop("outputs"),
    ],
)
def test_an_altered_record(workspace: Workspace, change: Callable[[object], object]) -> None:
    ran = workspace.write(CHAIN).run()
    store = ran.project.store
    key = str(ran.ended["twice"].key)
    edit(store.root / "actions" / key / "record.json", change)
    (found,) = damaged(store)
    assert (found.what, found.name, found.damage) == ("record", key, "altered since it was written")
    assert workspace.run().states["twice"] == "ran"
    assert damaged(store) == []


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content.pop("key"),
        lambda content: content.update(parts=[]),
        lambda content: content.update(outputs="a" * 64),
        lambda content: content["outputs"].update(numbers=content["outputs"]["numbers"] + "/../x"),
        lambda content: content.update(provenance=[]),
        lambda content: content["provenance"].pop("seconds"),
        lambda content: content["provenance"].update(seconds="1"),
        lambda content: content["provenance"].update(seconds=10**400),
        lambda content: content["provenance"].update(seconds=1.7e308),
        lambda content: content["provenance"].update(machine=[]),
        lambda content: content["provenance"].update(commit=[]),
        lambda content: content["provenance"].update(from_accepted=[[]]),
        lambda content: content["provenance"].update(accepted=3),
        lambda content: content["provenance"].update(accepted=[{"when": "today"}]),
    ],
)
def test_a_record_of_another_form_is_none_though_its_checksum_is_right(
    workspace: Workspace, change: Callable[[object], object]
) -> None:
    """So whatever reads records need not check what is in them."""
    ran = workspace.write(CHAIN).run()
    store = ran.project.store
    key = str(ran.ended["twice"].key)
    file = store.root / "actions" / key / "record.json"
    content = json.loads(file.read_text())
    del content[CHECKSUM]
    change(content)
    file.write_text(with_checksum(content))
    (found,) = damaged(store, dry_run=True)
    assert (found.what, found.name, found.damage) == ("record", key, "altered since it was written")
    collected = CliRunner().invoke(app, ["gc", "--dry-run", "--keep-last", "1", "--store", str(store.root)])
    assert "Run `verify` first, which sets damaged records aside" in collected.output
    assert CliRunner().invoke(app, ["show", str(ran.ended["twice"].outputs["numbers"])]).exit_code == 0
    assert workspace.run().states["twice"] == "ran"
    assert damaged(store) == []


def test_a_record_of_other_parts_than_its_key_says_though_its_checksum_is_right(
    workspace: Workspace,
) -> None:
    ran = workspace.write(CHAIN).run()
    key = str(ran.ended["twice"].key)
    file = ran.project.store.root / "actions" / key / "record.json"
    content = json.loads(file.read_text())
    del content[CHECKSUM]
    content["parts"]["parameters"]["factor"] = 3.0
    file.write_text(with_checksum(content))
    (found,) = damaged(ran.project.store)
    assert (found.what, found.name, found.damage) == ("record", key, "its parts do not match its key")
    assert workspace.run().states["twice"] == "ran"


def test_an_output_that_is_gone(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    store = ran.project.store
    store.delete_object(ran.ended["sum"].outputs["page"].name)
    assert [(checked.what, checked.name) for checked in damaged(store)] == [
        ("record", ran.ended["sum"].key),
        ("link", "chain/sum.page"),
    ]
    assert workspace.run().states["sum"] == "ran"
    assert damaged(store) == []


def test_a_record_that_a_run_wrote_anew_meanwhile_stays(workspace: Workspace) -> None:
    """All records are read first, and a terminal may take its time until the last was told."""
    workspace.write("stages:\n  a: {uses: numbers}\n  b: {uses: scale, in: {numbers: a}}\n")
    ran = workspace.run()
    for ended in ran.ended.values():
        (workspace.folder / "store" / "actions" / str(ended.key) / "record.json").write_bytes(b"")
    store = ran.project.store
    checked = verify_store(store)
    first = next(each for each in checked if each.what == "record")
    assert first.damage == "altered since it was written"
    assert set(workspace.run().states.values()) == {"ran"}
    assert [each for each in checked if each.damage] == []
    assert all(store.find(str(ended.key)) for ended in ran.ended.values())


def test_a_link_that_leads_nowhere(workspace: Workspace) -> None:
    store = workspace.write(CHAIN).run().project.store
    link = store.root / "latest" / "chain" / "old.numbers"
    link.symlink_to("../../objects/" + "0" * 64)
    (found,) = damaged(store)
    assert (found.what, found.name) == ("link", "chain/old.numbers")
    assert not link.is_symlink()


def test_a_pin_that_cannot_be_read_stays_and_is_told_again(workspace: Workspace) -> None:
    """Only the user knows what it was to keep."""
    store = workspace.write(CHAIN).run().project.store
    store.folder("pins").joinpath("paper.json").write_text("{")
    for _ in range(2):
        (found,) = damaged(store)
        assert (found.what, found.name) == ("pin", "paper")


def test_an_artifact_under_the_digest_of_another(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    store = ran.project.store
    store.object(ran.ended["twice"].outputs["numbers"].name).rename(store.object("f" * 64))
    found = {checked.what: checked.damage for checked in damaged(store)}
    assert "holds the artifact" in str(found["artifact"])
    assert set(found) == {"artifact", "record", "link"}


def test_a_whole_store_is_counted(workspace: Workspace) -> None:
    store = workspace.write(CHAIN).run().project.store
    whats = [checked.what for checked in verify_store(store)]
    assert (whats.count("artifact"), whats.count("record"), whats.count("link")) == (len(store.objects), 4, 6)
