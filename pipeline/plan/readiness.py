"""Whether this machine can do what is left of a run: hours later is too late to learn of a mistyped setting."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from pipeline.checkpoint import wished_seconds
from pipeline.errors import UserError
from pipeline.workflow.graph import Node

CHECK = "check"
"""The module of a library that exits with status 2 and a message if stages that use the library would not work."""

REFUSED = 2


def check_readiness(to_do: Iterable[Node], libraries: Iterable[str]) -> None:
    """Raises UserError if the environment would keep a stage in `to_do` from working in this process's workers.

    Each library is asked in a process of its own, and only if the code of such a stage uses it: loading it takes a
    while, and what it reserves when loaded is meant for the workers.
    """
    wished_seconds()
    used = {module.partition(".")[0] for node in to_do for module in node.code.modules}
    for library in libraries:
        if library in used:
            _ask(library)


def _ask(library: str) -> None:
    """Raises UserError with a library's message if it refuses. Any other failure is left for the stages to report."""
    done = subprocess.run(
        [sys.executable, "-P", "-m", f"{library}.{CHECK}"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(str(Path(path).absolute()) for path in sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == REFUSED:
        raise UserError(done.stderr.strip())
