"""The user's folder for data that the programs need besides their code, such as the weights of a metric.

Which files it holds may affect how a stage completes its parameters, and so the key of a result: see `Catalogue`.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import platformdirs


def data_folder() -> Path:
    """`$GS_HIDER_DATA`, by default the platform's usual place; it need not exist."""
    chosen = os.environ.get("GS_HIDER_DATA")
    return Path(chosen) if chosen else platformdirs.user_data_path("gs-hider")


def data_files() -> list[str]:
    """The names of the files in that folder, sorted; empty if it cannot be listed."""
    with suppress(OSError):
        return sorted(path.name for path in data_folder().iterdir())
    return []
