"""Valid names of pictures, photos and messages: those that tables, pages and files can all represent."""

from __future__ import annotations

import unicodedata

LONGEST_NAME = 300
"""In characters: a file name has up to 255, and its split may precede it."""
UNWRITTEN = ("Cc", "Cs")
"""Unicode categories of control characters and of surrogates, which Python makes of bytes that are not UTF-8."""


def can_be_written(name: str, longest: int = LONGEST_NAME) -> bool:
    """Whether a name is text that any program can read back: any kind of space is, a control character is not.

    >>> can_be_written("Screenshot 3.45\\u202fPM.png"), can_be_written("caf\\udce9.jpg"), can_be_written("")
    (True, False, False)
    """
    return 0 < len(name) <= longest and not any(unicodedata.category(each) in UNWRITTEN for each in name)
