"""New stores for tests. Each begins with what plans in the previous store have cached about the stages.

The first plan in an empty store takes some seconds to parse all sources and import all stages.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.store.opening import open_store

PLANS = ("sources", "declarations")
"""Folders of a store's cache that hold this."""


@pytest.fixture(scope="session")
def new_store() -> Callable[[Path], Path]:
    """A function that creates a store in a folder that does not exist yet."""
    made: list[Path] = []

    def make(folder: Path) -> Path:
        open_store(folder)
        for name in PLANS:
            if made and (made[-1] / "cache" / name).is_dir():
                shutil.copytree(made[-1] / "cache" / name, folder / "cache" / name)
        made.append(folder)
        return folder

    return make


@pytest.fixture
def store(tmp_path: Path, new_store: Callable[[Path], Path]) -> Path:
    """A new store for one test."""
    return new_store(tmp_path / "store")
