"""Singular and plural in messages."""

from __future__ import annotations

import re

CHOICE = re.compile(r"\[(?:([^][|]*)\|)?([^][|]*)\]")


def agreeing(count: int, text: str) -> str:
    """A text with the bracketed alternatives, singular and plural, resolved for `count`.

    "photo[s] [was|were] left out" becomes "photo was left out" or "photos were left out". Do not include text of
    unknown origin, such as file names.
    """
    return CHOICE.sub(lambda found: (found[1] or "") if count == 1 else found[2], text)


def counted(count: int, noun: str) -> str:
    """A number and a noun: "1 photo", "2 photos"."""
    return agreeing(count, f"{count} {noun}[s]")
