"""Fixtures for tests of several stages."""

from __future__ import annotations

import pytest

from pipeline.canonical import Json
from pipeline.stage import Context


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> dict[str, Json]:
    """The facts that stages record while a test runs."""
    facts: dict[str, Json] = {}
    monkeypatch.setattr(Context, "record", lambda context, **told: facts.update(told))
    return facts
