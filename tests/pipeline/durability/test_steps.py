"""A run is stopped at every step of its commit: killed, out of space, with a broken disk, without permission."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.pipeline.durability import stops
from tests.pipeline.durability.commands import ROOT


def stopped_at_every_step(folder: Path, how: str, where: str) -> list[dict[str, Any]]:
    """What happened at each step; the last of these is beyond the last step, and so undisturbed."""
    done = subprocess.run(
        [sys.executable, "-m", stops.__name__, str(folder), how, where], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    results = [json.loads(line) for line in done.stdout.splitlines()]
    for result in results:
        assert result["kept"], f"finished work was touched: {result}"
        assert result["again"] == 0, result
        assert result["objects"] == results[-1]["objects"], "another result than undisturbed"
        assert "Traceback" not in result["printed"], result["printed"]
    return results


LESSER = ("latest", "runs", "logs", "cache", "code", "temporary", ".gitignore")
"""Names in a store of what may be lost although the stage succeeds."""


@pytest.mark.parametrize("where", ["commit", pytest.param("run", marks=pytest.mark.slow)])
def test_killed(tmp_path: Path, where: str) -> None:
    *killed, last = stopped_at_every_step(tmp_path, "kill", where)
    assert {result["status"] for result in killed} == {-9}
    kinds = {step.split()[0] for step in last["step"]}
    assert kinds == {"open", "os.mkdir", "os.rename", "os.chmod", "os.remove", "os.rmdir", "os.symlink"}
    assert sum("/objects" in step or "/actions" in step for step in last["step"]) > 0


@pytest.mark.slow  # a real full disk is tested in test_disk.py
@pytest.mark.parametrize("where", ["commit", "run"])
@pytest.mark.parametrize("how", ["full", "broken", "denied"])
def test_a_failed_write_fails_the_stage(tmp_path: Path, how: str, where: str) -> None:
    """If the stage does not fail, nothing more was lost than a link, a log, or something cached or temporary."""
    *failed, _ = stopped_at_every_step(tmp_path, how, where)
    assert {result["status"] for result in failed} <= {0, 1, 2}
    for result in failed:
        step = result["step"][result["number"] - 1]
        exists = step in ("os.mkdir ", "os.mkdir /locks")
        lesser = exists or step.startswith("os.symlink")  # symlinks are those in `latest`
        lesser |= any(f"/{place}" in step for place in LESSER)
        if result["status"] == 0:
            assert lesser, step
        if how == "full" and result["status"] == 1:
            # The test's disk has room: an error that names no file is taken for that of another disk.
            assert "no space left on" in result["printed"], result["printed"]
            assert "free" in result["printed"]
