"""Where data that the programs need beside their code is kept for a user, such as the weights of a metric.

What lies there may decide how a stage completes its parameters, and so what a result is called: see `Catalogue`.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import platformdirs


def data_folder() -> Path:
    """`$GS_HIDER_DATA`, by default the platform's own place; it need not exist."""
    chosen = os.environ.get("GS_HIDER_DATA")
    return Path(chosen) if chosen else platformdirs.user_data_path("gs-hider")


def data_files() -> list[str]:
    """The names of what lies there, in order; none where nothing can be listed."""
    with suppress(OSError):
        return sorted(path.name for path in data_folder().iterdir())
    return []
