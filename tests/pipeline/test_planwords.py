"""The last line of `status`, and the times and failures that a plan knows."""

from __future__ import annotations

import pytest

from pipeline.history import StageResult
from pipeline.plan import Step
from pipeline.planwords import print_plan
from tests.pipeline.helpers import Workspace


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


def test_what_was_found_again_still_says_how_long_it_was_made(workspace: Workspace) -> None:
    workspace.write("stages:\n  base: {uses: numbers}")
    workspace.run()
    result = workspace.plan()["base"].result
    assert result is not None
    workspace.run()
    again = workspace.plan()["base"].result
    assert again is not None
    assert again.seconds == result.seconds > 0


def test_a_failure_with_other_settings_is_none_of_this_plan(workspace: Workspace) -> None:
    workspace.write("stages:\n  base: {uses: numbers}\n  bad: {uses: fail, in: {numbers: base}, with: {how: user}}")
    workspace.run()
    assert workspace.plan()["bad"].failed is not None
    assert workspace.plan("bad.how=death")["bad"].failed is None
