"""New stores for tests, which begin with what the plans of the one before them found out about the stages.

The first plan in an empty store parses all sources and imports all stages, for some seconds.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.store.opening import open_store

PLANS = ("sources", "declarations")
"""Folders of a store's cache that hold it."""


@pytest.fixture(scope="session")
def new_store() -> Callable[[Path], Path]:
    """Makes a store in a folder that is not there yet."""
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
    """The store of a test."""
    return new_store(tmp_path / "store")
