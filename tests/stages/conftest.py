"""What tests of several stages look at."""

from __future__ import annotations

import pytest

from pipeline.canonical import Json
from pipeline.stage import Context


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> dict[str, Json]:
    """What a stage says of itself while a test runs."""
    facts: dict[str, Json] = {}
    monkeypatch.setattr(Context, "record", lambda context, **told: facts.update(told))
    return facts
