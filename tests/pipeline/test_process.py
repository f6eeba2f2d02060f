"""What a process that runs stages makes for itself, and takes away."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FORKS = """
import os, sys
from pipeline.process import KernelCache
cache = KernelCache()
child = os.fork()
if child == 0:
    sys.exit()
os.waitpid(child, 0)
print(cache.folder, cache.folder.is_dir())
"""


def test_kernels_that_cannot_be_kept_go_with_the_process(tmp_path: Path) -> None:
    """A child that it forked takes nothing away."""
    (tmp_path / "file").touch()
    passing = tmp_path / "passing"
    passing.mkdir()
    told = {"POCL_CACHE_DIR": str(tmp_path / "file" / "kernels"), "TMPDIR": str(passing)}
    done = subprocess.run(
        [sys.executable, "-c", FORKS], cwd=ROOT, env={**os.environ, **told}, check=True, capture_output=True, text=True
    )
    folder, there = done.stdout.split()
    assert (Path(folder).is_relative_to(passing), there) == (True, "True")
    assert not list(passing.iterdir())
