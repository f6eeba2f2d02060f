"""Where toys report what they do: a line each, appended to the file that `TOLD` names, outside the store."""

from __future__ import annotations

import os


def tell(*words: object) -> None:
    """Appends a line with one system call, so that the lines of several processes do not mix."""
    path = os.environ.get("TOLD")
    if path:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        os.write(descriptor, (" ".join(map(str, words)) + "\n").encode())
        os.close(descriptor)
