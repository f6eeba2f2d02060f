"""What make passes to the commands that it calls."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.skipif(shutil.which("make") is None, reason="no make here")
@pytest.mark.parametrize("target", ["demo", "tables"])
def test_a_store_may_have_a_name_with_spaces(target: str) -> None:
    command = ["make", "--dry-run", target, "STORE=my disk/store", "PHOTOS=photos"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert '--store "my disk/store"' in done.stdout
