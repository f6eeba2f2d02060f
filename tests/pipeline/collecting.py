"""What several tests of `gc` share: they collect the garbage of a workspace and look at what is left."""

from __future__ import annotations

from pipeline.store.garbage import Collection, Rules, collect
from pipeline.store.opening import open_store
from pipeline.store.store import Store
from pipeline.store.verification import verify_store
from tests.pipeline.helpers import Workspace


def store_of(workspace: Workspace) -> Store:
    return open_store(workspace.folder / "store")


def collected(workspace: Workspace, **rules: object) -> Collection:
    store = store_of(workspace)
    with store.in_use(alone=True):
        collection = collect(store, Rules(**rules))  # type: ignore[arg-type]
        collection.delete()
    return collection


def is_cached(workspace: Workspace, *settings: str) -> bool:
    return all(step.state == "cached" for step in workspace.plan(*settings).values())


def assert_sound(store: Store) -> None:
    assert [checked for checked in verify_store(store) if checked.damage] == []
