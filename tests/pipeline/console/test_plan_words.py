"""The last line of `status`."""

from __future__ import annotations

import pytest

from pipeline.console.plan_words import print_plan
from pipeline.plan.plan import Step
from pipeline.store.history import StageResult


def cached(name: str, key: str, seconds: float) -> Step:
    return Step(name, "cached", key, result=StageResult(name, "cached", key, {}, seconds))


def test_what_is_shared_is_counted_once(capsys: pytest.CaptureFixture[str]) -> None:
    """Two scenes of the same photos share one reconstruction, whose time was spent once."""
    steps = [
        cached("cover", "a", 60),
        cached("message", "a", 60),
        cached("plain", "b", 15),
        Step("hide", "run", "c", reasons=("it has never run",)),
    ]
    print_plan({step.name: step for step in steps}, as_json=False)
    assert capsys.readouterr().out.splitlines()[-1] == "3 cached, 1 to run; the cached results took 1 min 15 s"


def test_of_nothing_that_is_cached_no_time_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """A workflow that has never run."""
    print_plan({"hide": Step("hide", "run", "c")}, as_json=False)
    assert capsys.readouterr().out.splitlines()[-1] == "1 to run"
