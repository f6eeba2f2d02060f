"""Text from strangers, such as a name in a file, made safe for a terminal, a log or a message."""

from __future__ import annotations

from collections.abc import Sequence

LONGEST_LINE = 120  # characters


def without_controls(text: str, allowed: str = "") -> str:
    """The text with `?` for each unprintable character, which a terminal might obey, except those `allowed`.

    >>> without_controls("red " + chr(27) + "[31m")
    'red ?[31m'
    """
    return "".join(character if character.isprintable() or character in allowed else "?" for character in text)


def listed(names: Sequence[str], most: int = 8) -> str:
    """The names separated by commas; of more than `most`, the first ones and how many more there are.

    >>> listed(["a", "b"]), listed(["a", "b", "c", "d"], 2), listed([])
    ('a, b', 'a, b and 2 more', '')
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"


def in_a_line(text: str, longest: int = LONGEST_LINE) -> str:
    """The text without controls or line breaks, cut to at most `longest` characters.

    >>> in_a_line("a.jpg" + chr(10) + "b" * 1000, 8)
    'a.jpg?b…'
    """
    line = without_controls(text)
    return line if len(line) <= longest else f"{line[: longest - 1]}…"
