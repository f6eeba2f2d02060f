"""Where a stage keeps what it needs to go on after an interruption: a private directory for each action."""

from __future__ import annotations

import shutil
from pathlib import Path

from pipeline.store import Store


def scratch_directory(store: Store, key: str) -> Path:
    """The scratch directory of an action, as an interrupted run left it or new; nobody else can read it."""
    store.folder("scratch")
    path = store.root / "scratch" / key
    path.mkdir(mode=0o700, exist_ok=True)
    return path


def discard_scratch(store: Store, key: str) -> None:
    """Deletes it: the action is committed and needs no checkpoint."""
    shutil.rmtree(store.root / "scratch" / key, ignore_errors=True)
