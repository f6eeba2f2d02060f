"""Disks and their troubles: what is not a plain file, JSON that is not JSON, no space, no permission.

A store may be damaged, or come from a stranger. So only plain files are read, and reading them gives a result or one of
two errors. What the system says when it cannot write is put into words for a person.
"""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

FULL = {errno.ENOSPC, errno.EDQUOT}
UNWRITABLE = {errno.EROFS: "a read-only file system", errno.EACCES: "no permission for you to write there"}
"""What a store has that cannot be written, by the error."""
IN_WORDS = FULL | {errno.EFBIG, errno.EROFS}
"""Errors for which `words_of` says what to do, whatever file they name."""
MUCH = 10**10
"""Free bytes above which a disk is hardly the one that is full: no stage writes that much at once."""


def read_plain_file(path: Path) -> bytes:
    """The bytes of a file. Raises OSError for anything else: a link, a folder, or a pipe, which would block."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a plain file", str(path))
        return file.read()


def parse_json(data: bytes | str) -> Any:
    """The value of a JSON text. Raises ValueError if it is not JSON, or too deeply nested to be read."""
    try:
        return json.loads(data)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def read_json_object(path: Path) -> dict[str, Any] | None:
    """The JSON object in a file; None if there is none, or it cannot be read."""
    try:
        content = parse_json(read_plain_file(path))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def size_of_plain_file(path: Path) -> int | None:
    """The size of a file in bytes; None if it is not a plain file."""
    try:
        found = path.lstat()
    except (OSError, ValueError):  # a name that no file can have
        return None
    return found.st_size if stat.S_ISREG(found.st_mode) else None


def entries_of(root: Path, *names: str, links: bool = False) -> list[os.DirEntry[str]]:
    """The entries of the folder `names` under `root`, sorted by name; with `links`, links too. Empty if unreadable.

    A folder that is reached over a link counts as empty: a store may come from a stranger, and a link in it could lead
    to anyone's files.
    """
    if leads_elsewhere(root, *names):
        return []
    try:
        with os.scandir(root.joinpath(*names)) as found:
            return sorted((entry for entry in found if links or not entry.is_symlink()), key=lambda entry: entry.name)
    except OSError:
        return []


def leads_elsewhere(root: Path, *names: str) -> bool:
    """Whether the path from `root` along `names` could leave `root`: over a link, or by a name such as `..`."""
    ways = [root.joinpath(*names[: number + 1]) for number in range(len(names))]
    return any(name in ("", ".", "..") for name in names) or any(map(is_link, ways))


def is_link(path: Path) -> bool:
    """Whether a path is a symbolic link; False for names that no file can have."""
    try:
        return path.is_symlink()
    except OSError:
        return False


def words_of(error: OSError, store: Path | str, written: int = 0) -> str:
    """What the system refused, on one line. `written` is the number of bytes that the current work had written.

    A full disk is assumed to be that of `store`, unless the error names a file elsewhere, or that disk has much room.
    """
    if error.errno == errno.EFBIG:
        return _words_of_too_large(error.filename or store)
    found = _unwritable(error, store)
    if found:
        return (
            f"{store}: the store cannot be written; found {found}. Make it writable, or copy it to "
            "where you can write, and name that with --store or $GS_HIDER_STORE; `status`, `show`, `export` and "
            "`verify` work with it as it is."
        )
    if error.errno not in FULL:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}"
    elsewhere = _elsewhere(error.filename, store)
    if elsewhere:
        room = _room_words(elsewhere)
        return f"no space left on the disk that holds {elsewhere}: {room}. Make room there, then run again."
    so_far = f", after {size_words(written)} were written" if written else ""
    kept = "Completed work is kept; make room, then run again."
    if "://" in str(store):
        return f"no space left on this machine's disk, which holds copies of what is in {store}{so_far}. {kept}"
    room = _room_words(store)
    if error.errno == errno.ENOSPC and (free_bytes(store) or 0) > MUCH:
        other = f"probably not the one that holds {store}, which has {room}, but the one with /tmp or the home folder"
        return f"no space left on a disk{so_far}, {other}. {kept}"
    return f"no space left on the disk that holds {store}: {room}{so_far}. {kept}"


@contextmanager
def written_to(place: Path) -> Iterator[None]:
    """Puts `place` into errors of its block that `words_of` explains: about a full disk, the system names no file."""
    try:
        yield
    except OSError as error:
        if error.errno in IN_WORDS:
            error.filename = str(place)
        raise


def _words_of_too_large(place: object) -> str:
    """That a file would have been larger than this process, or its disk, allows."""
    allowed = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    kept = "then run again; completed work is kept."
    if allowed == resource.RLIM_INFINITY:
        return f"{place}: a file is larger than its disk allows. Use a disk that allows larger files, {kept}"
    return (
        f"{place}: a file is larger than this process may write; found a limit of {size_words(allowed)} a file, which "
        f"`ulimit -f` sets. Raise it, for example with `ulimit -f unlimited`, {kept}"
    )


def _unwritable(error: OSError, store: Path | str) -> str | None:
    """Why the store cannot be written, if that is the error; someone's secrets in it may just not be readable."""
    if error.errno == errno.EACCES and (error.filename is None or os.access(store, os.W_OK)):
        return None
    return None if error.errno is None or _elsewhere(error.filename, store) else UNWRITABLE.get(error.errno)


def _elsewhere(file: object, store: Path | str) -> Path | None:
    """The file that an error names; None if it names none, or one in the store."""
    path = Path(file).absolute() if isinstance(file, str | os.PathLike) else None
    return None if path is None or path.is_relative_to(Path(store).absolute()) else path


def bytes_below(folder: Path) -> int:
    """The number of bytes in the files under a folder, as far as they can be seen."""
    return sum(size_of_plain_file(path) or 0 for path in folder.rglob("*")) if folder.is_dir() else 0


def size_of(path: Path) -> int:
    """Bytes of a file or link, or of all files and links under a folder; 0 if there is nothing, or no longer."""
    if path.is_symlink() or not path.is_dir():
        return _size_there(path)
    below = ((Path(folder, name), name in names) for folder, names, files in os.walk(path) for name in (*names, *files))
    return sum(_size_there(entry) for entry, is_folder in below if not is_folder or entry.is_symlink())


def _size_there(path: Path) -> int:
    """Bytes of a file or link; 0 if another process has just removed it."""
    try:
        return path.lstat().st_size
    except OSError:
        return 0


def size_at(path: Path) -> int:
    """Bytes of the file to which a path leads, over links; 0 if there is none that can be seen."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def remove(path: Path) -> None:
    """Deletes a file, or a folder with everything in it, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def flush(path: Path) -> None:
    """Makes a file's content, or a directory's entries, survive a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(root: Path, *names: str) -> Path:
    """The folder `names` under `root`, created if it is missing; its creation survives a power cut."""
    path = root.joinpath(*names)
    if not path.is_dir():
        path.mkdir(parents=True, exist_ok=True)
        for parent in (path, *path.parents[: len(names)]):
            flush(parent)
    return path


def remove_where_it_lies(folder: Path, first: str) -> None:
    """Deletes a folder that cannot be moved aside first for lack of space.

    Its file `first` goes first: without it the rest counts for nothing, even if the deletion breaks off.
    """
    if folder.is_dir() and not folder.is_symlink():
        (folder / first).unlink(missing_ok=True)
    remove(folder)


def close_to_others(folder: Path) -> None:
    """Takes all permissions on a folder from everyone but its owner; leaves another user's folder as it is."""
    if stat.S_IMODE(folder.stat().st_mode) & 0o077:
        with suppress(PermissionError):
            folder.chmod(0o700)


def size_words(size: int) -> str:
    """A size in words, in decimal units.

    >>> size_words(512), size_words(1536), size_words(12_600_000), size_words(10**9)
    ('512 B', '1.5 kB', '12.6 MB', '1.0 GB')
    """
    amount, unit = float(size), "B"
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if amount < 1000 or unit == "TB":
            break
        amount /= 1000
    return f"{amount:.0f} {unit}" if unit == "B" else f"{amount:.1f} {unit}"


def is_read_only(path: Path) -> bool:
    """Whether the disk of a path, which need not exist, is read-only; False if that cannot be determined.

    A path that exists is also read-only if its permissions do not let this user write there.
    """
    room = _room_on(path)
    return (room is not None and bool(room.f_flag & os.ST_RDONLY)) or (path.exists() and not os.access(path, os.W_OK))


def _room_on(path: Path | str) -> os.statvfs_result | None:
    """The state of the disk of a path, or of its nearest parent that exists; None if that cannot be determined."""
    try:
        there = next((place for place in (Path(path), *Path(path).parents) if place.exists()), None)
        return os.statvfs(there) if there else None
    except OSError:
        return None


def free_bytes(path: Path | str) -> int | None:
    """Bytes free for this user on the disk of a path, which need not exist; None if that cannot be determined.

    0 if the disk has no free inodes.
    """
    room = _room_on(path)
    if room is None:
        return None
    return 0 if _lacks_inodes(room) else room.f_bavail * room.f_frsize


def _lacks_inodes(room: os.statvfs_result) -> bool:
    numbered = room.f_files > 0  # otherwise the file system makes inodes as it needs them
    return numbered and room.f_favail == 0


def _room_words(path: Path | str) -> str:
    room = _room_on(path)
    if room is None:
        return f"{size_words(0)} free"
    free = f"{size_words(room.f_bavail * room.f_frsize)} free"
    return f"no free inodes, and each file needs one ({free})" if _lacks_inodes(room) else free
