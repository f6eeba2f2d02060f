"""What make passes to the commands that it calls."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make here")


@pytest.mark.parametrize("target", ["demo", "tables"])
def test_a_store_may_have_a_name_with_spaces(target: str) -> None:
    command = ["make", "--dry-run", target, "STORE=my disk/store", "PHOTOS=photos"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert '--store "my disk/store"' in done.stdout


@pytest.mark.parametrize("target", ["demo", "tables"])
def test_the_store_that_the_environment_names_is_used(target: str) -> None:
    """Photos and secrets land there, and the commands after it look there."""
    named = {**os.environ, "GS_HIDER_STORE": "/disk/store"}
    command = ["make", "--dry-run", target, "PHOTOS=photos"]
    done, other = (
        subprocess.run(each, cwd=ROOT, env=named, capture_output=True, text=True, check=True)
        for each in (command, [*command, "STORE=mine"])
    )
    assert '--store "/disk/store"' in done.stdout
    assert '--store "mine"' in other.stdout


def made(folder: Path, status: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    """`make tables` with a Python that ends with `status` in place of the environment's."""
    (folder / "bin").mkdir()
    (folder / "bin" / "python").write_text(f'#!/bin/sh\necho "$@"\nexit {status}\n')
    (folder / "bin" / "python").chmod(0o755)
    (folder / "installed").touch()
    command = ["make", "tables", f"VENV={folder}", "-o", f"{folder}/installed", "PHOTOS=photos", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_rows_that_are_not_there_are_not_replaced_by_others(tmp_path: Path) -> None:
    done = made(tmp_path, 0, "ROWS=nowhere")
    assert done.returncode
    assert "ROWS=nowhere: no such folder" in done.stdout
    assert "pipeline run" not in done.stdout


@pytest.mark.parametrize(("status", "goes_on"), [(1, True), (2, False)])
def test_what_cannot_run_as_it_is_is_told_from_what_goes_on(tmp_path: Path, status: int, goes_on: bool) -> None:
    done = made(tmp_path, status, "TABLES=fidelity probes")
    assert done.returncode
    assert ("Not whole: fidelity probes. The same command goes on." in done.stdout) is goes_on
    assert ("Not run, for what is said above: fidelity probes." in done.stdout) is not goes_on
