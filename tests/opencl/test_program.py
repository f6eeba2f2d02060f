"""The source text of programs."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from opencl.contract import RasterSettings
from opencl.program import ProgramKey


def test_sources_count_as_they_were_when_the_module_was_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A program is built when it is first needed, perhaps hours after the run was planned."""
    key = ProgramKey("blending", "cpu", torch.float32, RasterSettings(), feature_dim=5)
    before = key.text()
    monkeypatch.setattr(Path, "read_text", lambda *given, **options: "edited")
    assert key.text() == before
    assert "edited" not in before
