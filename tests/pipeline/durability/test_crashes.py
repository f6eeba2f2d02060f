"""A worker that crashes inside a driver: the stage fails with its cause and log, and no other stage does."""

from __future__ import annotations

from pathlib import Path

from pipeline.store.store import Store
from tests.pipeline.durability import commands
from tests.pipeline.durability.commands import TOYS
from tests.pipeline.helpers import Workspace

WORKFLOW = """
    name: crashes
    stages:
      aborts: {uses: crash, with: {how: abort}}
      faults: {uses: crash, with: {how: segment}}
      small:  {uses: grow, with: {steps: 2, size: 100}}
      after:  {uses: gather, in: {numbers: small}}
      never:  {uses: gather, in: {numbers: [small, aborts]}}
    """


def test_workers_that_crash(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path, TOYS).write(WORKFLOW)
    status, printed = commands.call(workspace, "--workers", "2")
    assert status == 1
    assert "Traceback" not in printed, printed
    for name, words in (("aborts", "Aborted"), ("faults", "Segmentation fault")):
        assert f"{name}: failed: its worker process died" in printed
        log = (tmp_path / f"store/logs/crashes/{name}.log").read_text()
        assert "about to crash" in log
        assert f"Fatal Python error: {words}" in log, "where it crashed"
        assert 'crash.py"' in log
    assert "never: skipped: needs aborts, which was not made" in printed
    assert "crashes: 2 ran, 2 failed, 1 skipped" in printed
    kept = commands.finished(Store(tmp_path / "store"))
    workspace.write(WORKFLOW.replace("aborts:", "mended:").replace("[small, aborts]", "[small]"))
    status, printed = commands.call(workspace, "--serial", "after", "never", "mended", "--set", "mended.how=never")
    assert status == 0, printed
    store = Store(tmp_path / "store")
    assert kept.items() <= commands.finished(store).items()
    assert not list(store.root.glob("temporary/*/*"))
