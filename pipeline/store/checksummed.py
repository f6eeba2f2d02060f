"""Small files of the store: written whole, with a checksum inside that reveals any alteration."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.canonical import digest_of
from pipeline.disk import read_json_object

CHECKSUM = "sha256"


def write_text_whole(path: Path, text: str, aside: Path, mode: int = 0o666) -> None:
    """Writes a file atomically: readers see the old one or the new one, never a part. Does not flush it to disk.

    `aside` is where it is written first, on the same file system.
    """
    aside.touch(mode)
    aside.write_text(text, encoding="utf-8")
    aside.replace(path)


def with_checksum(content: Mapping[str, Any]) -> str:
    """`content` as JSON, with a checksum by which `read_checksummed` knows that it is whole."""
    return json.dumps({**content, CHECKSUM: digest_of(dict(content))}, indent=1, sort_keys=True, allow_nan=False) + "\n"


def read_checksummed(path: Path) -> dict[str, Any] | None:
    """The content of a file that `with_checksum` made, without the checksum; None if it is missing or altered."""
    content = read_json_object(path)
    try:
        return content if content and content.pop(CHECKSUM, None) == digest_of(content) else None
    except (TypeError, ValueError, RecursionError):
        return None
