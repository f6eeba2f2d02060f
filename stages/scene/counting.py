"""How many of what, in words for people."""

from __future__ import annotations


def counted(count: int, noun: str) -> str:
    """A number with its noun, which takes an s unless it is one.

    "1 photo", "2 photos", "0 photos".
    """
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
