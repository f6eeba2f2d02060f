"""How a file looks from outside, which tells whether one that was read before has to be read again.

A file looks the same if its size, modification time, change time, inode and device are the same. No program can set the
change time, so a file that is replaced, restored with its old times or renamed over another always looks different. But
two writes within one tick of the clock look the same. So a look is not trusted if the file changed less than `SETTLED`
before it was read, or seems to change in the future. A modification time in the future is no reason for distrust: it
comes from, say, a camera with a wrong clock, and the change time tells when it was written.
"""

from __future__ import annotations

import os

SETTLED = 2_000_000_000  # nanoseconds; the coarsest clock of a file system (FAT) ticks every two seconds

Look = tuple[int, ...]


def look_of(status: os.stat_result) -> Look:
    """Size, modification time, change time, inode and device."""
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino, status.st_dev


def is_settled(look: Look, moment: int) -> bool:
    """Whether a file with this look when it was read, at `moment` (nanoseconds), will look different once changed."""
    _, modified, changed, _, _ = look
    latest = changed if modified > moment else max(modified, changed)
    return moment - latest > SETTLED
