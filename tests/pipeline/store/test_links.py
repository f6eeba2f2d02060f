"""Links in a store from elsewhere: nothing that they lead to is deleted, listed or closed to others."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import UserError
from pipeline.store.garbage import Rules, collect
from pipeline.store.store import Store
from pipeline.store.verification import verify_store
from tests.pipeline.helpers import CHAIN, Workspace

DIGEST = "0" * 64


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """Folders that look like those of a store to whatever follows a link."""
    home = tmp_path / "home"
    for name in ("chain/old.log", "a.jsonl", "evil/old.jsonl", f"{DIGEST}/file", "private/a.log"):
        (home / name).parent.mkdir(parents=True, exist_ok=True)
        (home / name).write_text("mine")
    (home / "old.numbers").symlink_to(f"../../objects/{DIGEST}")
    (home / "chain" / "old.numbers").symlink_to(f"../../objects/{DIGEST}")
    home.chmod(0o755)
    return home


def listed(folder: Path) -> list[tuple[Path, int]]:
    return sorted((path, path.lstat().st_mode) for path in (folder, *folder.rglob("*")))


LINKS = [
    "latest/evil",
    "runs/evil",
    "logs/evil",
    f"scratch/{DIGEST}",
    "latest",
    "runs",
    "scratch",
    "temporary",
    "damaged",
]


@pytest.mark.parametrize("name", LINKS)
def test_what_links_lead_to_is_left_alone(workspace: Workspace, home: Path, name: str) -> None:
    store = workspace.write(CHAIN).run().project.store
    link = store.root / name
    if link.exists():
        link.rename(workspace.folder / "before")
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(home)
    before = listed(home)
    store = Store(store.root)
    assert list(verify_store(store))
    collect(store, Rules(keep_last=1)).delete()
    assert "evil/old.numbers" not in store.latest_digests()
    assert "evil" not in store.history.workflows()
    assert listed(home) == before
    assert set(workspace.run().states.values()) <= {"cached", "ran"}
    assert set(listed(home)) >= set(before)


def test_nothing_is_written_into_what_a_link_leads_to(workspace: Workspace, home: Path) -> None:
    """Neither logs, since old ones are deleted, nor damaged data, since its folder is closed to others."""
    store = workspace.write(CHAIN).run().project.store
    (store.root / "logs").rename(workspace.folder / "before")
    for name in ("logs", "damaged"):
        (store.root / name).symlink_to(home)
    before = listed(home)
    ran = workspace.run("factor=3")
    assert ran.states["twice"] == "failed"
    assert "a link; expected a folder" in str(ran.ended["twice"].cause)
    with pytest.raises(UserError, match="a link; expected a folder"):
        store.set_record_aside(next(iter(store.actions)))
    (store.root / "damaged").unlink()
    (store.root / "damaged").mkdir()
    (store.root / "damaged/actions").symlink_to(home)
    with pytest.raises(UserError, match="a link; expected a folder"):
        store.set_record_aside(next(iter(store.actions)))
    assert listed(home) == before


def test_only_links_to_objects_count(workspace: Workspace) -> None:
    store = workspace.write(CHAIN).run().project.store
    known = store.latest_digests()
    for name, target in {"a.out": "/etc", "b.out": f"../objects/{DIGEST}", "c.out": f"../../objects/{DIGEST}0"}.items():
        (store.root / "latest/chain" / name).symlink_to(target)
    assert store.latest_digests() == known
    assert [checked for checked in verify_store(store) if checked.damage] == []
    store.unlink_latest("chain/a.out")
    assert (store.root / "latest/chain/a.out").is_symlink()


@pytest.mark.parametrize("name", ["logs/..", "logs/../x", "../x", "x", "logs/", "logs/evil/a.log", "/etc/x"])
def test_a_name_that_leads_elsewhere_is_not_deleted(tmp_path: Path, home: Path, name: str) -> None:
    store = Store(tmp_path / "store")
    for folder in ("logs", "x"):
        store.folder(folder)
    (store.root / "logs/evil").symlink_to(home)
    before = listed(tmp_path)
    with pytest.raises(UserError, match="not the name of something in the store"):
        store.delete_entry(name)
    assert listed(tmp_path) == before
