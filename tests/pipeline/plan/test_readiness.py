"""What cannot work on this machine is said before a run does anything, and only if the run would need it."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner, Result

from opencl.device import DEVICE_VARIABLE, list_devices
from pipeline.checkpoint import EVERY_VARIABLE
from pipeline.cli import app
from pipeline.store.store import Store
from tests.pipeline.helpers import TOYS, Workspace

DRAWN = """
    name: drawn
    stages:
      base:  {uses: numbers}
      drawn: {uses: with_device, in: {numbers: base}}
      after: {uses: scale, in: {numbers: drawn}}
    """


@pytest.fixture
def drawn(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    monkeypatch.setenv("GS_HIDER_STORE", str(workspace.folder / "store"))
    monkeypatch.delenv(DEVICE_VARIABLE, raising=False)
    monkeypatch.delenv(EVERY_VARIABLE, raising=False)
    return workspace.write(DRAWN)


def run(workspace: Workspace, *arguments: str) -> Result:
    where = [] if "--scheduler" in arguments else ["--serial"]
    return CliRunner().invoke(app, ["run", str(workspace.file), "--stages", TOYS, *where, *arguments])


@pytest.mark.parametrize("device", ["nonsense", "9:9"])
def test_a_device_that_is_not_there(drawn: Workspace, monkeypatch: pytest.MonkeyPatch, device: str) -> None:
    monkeypatch.setenv(DEVICE_VARIABLE, device)
    refused = run(drawn)
    assert refused.exit_code == 2
    assert f"{DEVICE_VARIABLE}: found '{device}', expected an index or part of a name of one of: " in refused.output
    assert list_devices()[0].name in refused.output
    assert f"Set {DEVICE_VARIABLE} to one of these, or unset it for the default one." in refused.output
    assert not Store(drawn.folder / "store").actions, "nothing ran"


def test_stages_that_need_no_device_run_all_the_same(drawn: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(drawn, "drawn").exit_code == 0
    monkeypatch.setenv(DEVICE_VARIABLE, "nonsense")
    assert run(drawn).exit_code == 0, "what draws is in the store"
    assert run(drawn).exit_code == 0, "all is in the store"
    assert run(drawn, "base", "--set", "base.first=3").exit_code == 0
    assert run(drawn, "--set", "base.first=3").exit_code == 2
    assert run(drawn, "--set", "base.first=3", "--dry-run").exit_code == 0, "it is only looked at"


@pytest.mark.parametrize("seconds", ["often", "-1", "nan", "1 min"])
def test_a_pause_between_checkpoints_that_is_no_number(
    drawn: Workspace, monkeypatch: pytest.MonkeyPatch, seconds: str
) -> None:
    monkeypatch.setenv(EVERY_VARIABLE, seconds)
    refused = run(drawn)
    assert refused.exit_code == 2
    assert f"{EVERY_VARIABLE}: not a number of seconds; found {seconds}; expected a number such" in refused.output
    assert "Unset it to write one about every 60 seconds." in refused.output
    assert not Store(drawn.folder / "store").actions, "nothing ran"


def test_workers_elsewhere_have_settings_of_their_own(drawn: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """Settings of this machine do not apply to them: all that is wrong is that there is no such scheduler."""
    monkeypatch.setenv(DEVICE_VARIABLE, "nonsense")
    refused = run(drawn, "--scheduler", "nonsense")
    assert (refused.exit_code, DEVICE_VARIABLE in refused.output) == (2, False)
