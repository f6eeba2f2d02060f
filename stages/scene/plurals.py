"""Words for people that go with a number."""

from __future__ import annotations

import re

CHOICE = re.compile(r"\[(?:([^][|]*)\|)?([^][|]*)\]")


def agreeing(count: int, text: str) -> str:
    """A text with the words that go with a number, where it has some for one and for any other in brackets.

    Of "photo[s] [was|were] left out" these are "photo was left out" and "photos were left out". Nothing that others
    may have written, such as names of files, belongs in such a text.
    """
    return CHOICE.sub(lambda found: (found[1] or "") if count == 1 else found[2], text)


def counted(count: int, noun: str) -> str:
    """A number and a noun: "1 photo", "2 photos"."""
    return agreeing(count, f"{count} {noun}[s]")
