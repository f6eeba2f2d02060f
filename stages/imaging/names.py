"""What pictures, photos and messages may be called: what tables, pages and files can say."""

from __future__ import annotations

import unicodedata

LONGEST_NAME = 300
"""Characters: a file's name has up to 255, and may have its split before it."""
UNWRITTEN = ("Cc", "Cs")
"""Unicode's categories of control characters, and of what Python makes of bytes that are no UTF-8."""


def can_be_written(name: str) -> bool:
    """Whether a name is text that any program reads back: spaces of all widths are, line ends are not.

    >>> can_be_written("Screenshot 3.45\\u202fPM.png"), can_be_written("caf\\udce9.jpg"), can_be_written("")
    (True, False, False)
    """
    return 0 < len(name) <= LONGEST_NAME and not any(unicodedata.category(each) in UNWRITTEN for each in name)
