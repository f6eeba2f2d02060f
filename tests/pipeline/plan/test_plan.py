"""What a plan says of a stage: while it is being run elsewhere, how long it took, and how it failed."""

from __future__ import annotations

import pytest

from pipeline.console.plan_words import print_plan
from pipeline.events import Event, StageStarted
from pipeline.plan.explanation import explain, in_words
from pipeline.plan.plan import Step, make_plan
from pipeline.run.executor import SerialExecutor, Tell
from tests.pipeline.helpers import Workspace

TWO = """
    name: two
    stages:
      base:  {uses: numbers}
      twice: {uses: scale, in: {numbers: base}}
    """


class Planning(SerialExecutor):
    """Makes a plan whenever a stage begins, as `status` does if it is called meanwhile."""

    def __init__(self, workspace: Workspace, *settings: str) -> None:
        super().__init__()
        self.workspace = workspace
        self.settings = settings
        self.plans: dict[str, dict[str, Step]] = {}

    def wait(self, tell: Tell, seconds: float) -> tuple[str, object] | None:
        def told(event: Event) -> None:
            tell(event)
            if isinstance(event, StageStarted):
                self.plans[event.name] = self.workspace.plan(*self.settings)

        return super().wait(told, seconds)


def test_what_runs_is_said_with_its_log(workspace: Workspace, capsys: pytest.CaptureFixture[str]) -> None:
    executor = Planning(workspace.write(TWO))
    workspace.run(executor=executor)
    log = workspace.folder / "store/logs/two/base.log"
    print_plan(executor.plans["base"], as_json=False)
    assert capsys.readouterr().out.splitlines() == [
        f"base   running now  log: {log}",
        "twice  to run  it has never run",
        "1 to run, 1 running now",
    ]
    assert [step.state for step in executor.plans["twice"].values()] == ["cached", "running"]
    assert [step.state for step in workspace.plan().values()] == ["cached", "cached"]


def test_what_changed_is_explained_while_it_runs(workspace: Workspace) -> None:
    workspace.write(TWO).run()
    executor = Planning(workspace, "twice.factor=7")
    workspace.run("twice.factor=7", executor=executor)
    project = workspace.open("twice.factor=7")
    (explanation,) = explain(project.graph, executor.plans["twice"], project.store, ["twice"])
    assert in_words(explanation, project.graph, "") == [
        "twice: running now",
        f"  log: {workspace.folder / 'store/logs/two/twice.log'}",
        "  parameter factor: 2.0 → 7.0",
    ]


def test_a_log_of_something_else_is_not_named(workspace: Workspace) -> None:
    """Another workflow is doing the same action; this stage's log is that of an earlier action."""
    workspace.write(TWO).run()
    project = workspace.open("base.count=9")
    key = make_plan(project.graph, project.store)["base"].key
    assert key
    with project.store.lock(key):
        step = workspace.plan("base.count=9")["base"]
    assert (step.state, step.reasons[0]) == ("running", "as another stage, or in another workflow")
    assert workspace.plan("base.count=9")["base"].state == "run", "a lock that nobody holds means nothing"


def test_to_plan_makes_no_locks(workspace: Workspace) -> None:
    store = workspace.write(TWO).open().store
    before = sorted(store.root.rglob("*.lock"))
    workspace.plan()
    assert sorted(store.root.rglob("*.lock")) == before


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
    assert workspace.plan("bad.how=defect")["bad"].failed is None
    workspace.run("bad.how=defect")
    assert workspace.plan("bad.how=defect")["bad"].failed is not None
    assert workspace.plan()["bad"].failed is None, "the last failure counts"
