"""Small files of the store: written whole, and with a checksum in them, so that what was altered is known as such."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.canonical import digest_of
from pipeline.disk import read_json_object

SEAL = "sha256"


def write_text_whole(path: Path, text: str, aside: Path, mode: int = 0o666) -> None:
    """Writes a file so that readers see the old or the new one, never a part."""
    aside.touch(mode)
    aside.write_text(text)
    aside.replace(path)


def sealed(content: Mapping[str, Any]) -> str:
    """JSON with a checksum in it, by which `read_sealed` knows that it is whole."""
    return json.dumps({**content, SEAL: digest_of(dict(content))}, indent=1, sort_keys=True, allow_nan=False) + "\n"


def read_sealed(path: Path) -> dict[str, Any] | None:
    """What `sealed` made of something; None where that is missing or not what was written."""
    content = read_json_object(path)
    try:
        return content if content and content.pop(SEAL, None) == digest_of(content) else None
    except (TypeError, ValueError, RecursionError):
        return None
