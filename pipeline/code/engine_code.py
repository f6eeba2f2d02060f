"""Whether a worker runs the same engine as the run that it works for: they exchange the engine's own objects."""

from __future__ import annotations

import functools
from pathlib import Path

from pipeline.canonical import digest_of, digest_of_file
from pipeline.errors import UserError

ENGINE = Path(__file__).parents[1]


@functools.cache
def engine_digest() -> str:
    """SHA-256 over the engine's own sources, as they were when this process first asked."""
    files = sorted(ENGINE.rglob("*.py"))
    return digest_of({file.relative_to(ENGINE).as_posix(): digest_of_file(file) for file in files}, "the engine")


def check_engine(digest: str) -> None:
    """Raises UserError if the engine of this process does not have that digest."""
    if digest != engine_digest():
        raise UserError(
            "the worker has a different version of the engine than the run",
            where=ENGINE,
            expected="the same sources",
            remedy="Give the workers the same version (PYTHONPATH), and restart them.",
        )
