"""Every test has a workspace, and a kernel cache away from the user's."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pipeline.helpers import Workspace


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "kernels"))
    return Workspace(tmp_path)
