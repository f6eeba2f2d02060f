"""A file that has been read is not read again, and one that has changed always is, however it was changed."""

from __future__ import annotations

import json
import os
import shutil
import stat
import sys
import time
from collections.abc import Callable
from io import BufferedReader
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import UserError
from pipeline.store import external_cache
from pipeline.store.external import contents_of
from pipeline.store.external_cache import ExternalCache
from pipeline.store.look import SETTLED
from pipeline.store.store import Store
from tests.pipeline.helpers import Workspace

NAMES = ["a.jpg", "b.jpg", "deep/a.jpg"]
CONTENTS = [b"1111", b"2222", b"333"]


class Clock:
    """Puts the time of hashing ahead, so that what was just written counts as settled long ago."""

    def __init__(self) -> None:
        self.ahead = 0

    def time_ns(self) -> int:
        return time.time_ns() + self.ahead


class Photos:
    """A folder of photos with a store beside it; counts the files that are read."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.folder = root / "photos"
        self.store = Store(root / "store")
        self.cache = ExternalCache(self.store)
        self.read: list[str] = []
        for name in NAMES:
            self.write(name, CONTENTS[0])

    def write(self, name: str, data: bytes) -> None:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)

    def is_right(self) -> bool:
        return self.cache.digest(self.folder) == contents_of(self.folder).digest

    def await_tick(self) -> None:
        """Returns when a file written now gets a later change time than all that were written before."""
        probe = self.root / "probe"
        probe.write_bytes(b"")
        before = probe.stat().st_ctime_ns
        while probe.stat().st_ctime_ns == before:
            probe.write_bytes(b"")
            os.utime(probe)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(external_cache, "time", clock)
    return clock


@pytest.fixture
def photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Photos:
    photos = Photos(tmp_path)
    digest = external_cache.file_digest

    def counted(file: BufferedReader, algorithm: str) -> object:
        photos.read.append(file.name.removeprefix(f"{photos.folder}/"))
        return digest(file, algorithm)

    monkeypatch.setattr(external_cache, "file_digest", counted)
    return photos


def overwrite(photos: Photos, name: str, data: bytes) -> None:
    photos.write(name, data)


def rename_over(photos: Photos, name: str, data: bytes) -> None:
    other = photos.root / "other"
    other.write_bytes(data)
    other.rename(photos.folder / name)


def replace_with_old_times(photos: Photos, name: str, data: bytes) -> None:
    """Restores the times, as `cp -p` and `touch -d` do."""
    path = photos.folder / name
    before = path.stat()
    path.write_bytes(data)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def copy_with_times(photos: Photos, name: str, data: bytes) -> None:
    other = photos.root / "other"
    other.write_bytes(data)
    before = (photos.folder / name).stat()
    os.utime(other, ns=(before.st_atime_ns, before.st_mtime_ns))
    shutil.copy2(other, photos.folder / name)


def delete_and_make_anew(photos: Photos, name: str, data: bytes) -> None:
    (photos.folder / name).unlink()
    photos.write(name, data)


def point_elsewhere(photos: Photos, name: str, data: bytes) -> None:
    target = photos.root / f"target{data[:1].decode()}"
    target.write_bytes(data)
    (photos.folder / name).unlink()
    (photos.folder / name).symlink_to(target)


def swap(photos: Photos, name: str, data: bytes) -> None:
    photos.write(name, data)
    one, aside = photos.folder / name, photos.root / "aside"
    other = photos.folder / ("a.jpg" if name == "b.jpg" else "b.jpg")
    one.rename(aside)
    other.rename(one)
    aside.rename(other)


WAYS: list[Callable[[Photos, str, bytes], None]] = [
    overwrite,
    rename_over,
    replace_with_old_times,
    copy_with_times,
    delete_and_make_anew,
    point_elsewhere,
    swap,
]


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.lists(
        st.tuples(st.sampled_from(WAYS), st.sampled_from(NAMES), st.sampled_from(CONTENTS), st.booleans()), max_size=8
    )
)
def test_never_a_stale_digest(edits: list[tuple[Callable[[Photos, str, bytes], None], str, bytes, bool]]) -> None:
    """Even if the file is replaced within the clock tick in which it was read."""
    with TemporaryDirectory() as folder:
        photos = Photos(Path(folder))
        assert photos.is_right()
        for way, name, data, often in edits:
            way(photos, name, data)
            for _ in range(1 + often):
                assert photos.is_right(), way.__name__


@pytest.mark.parametrize("way", WAYS)
def test_what_is_settled_is_read_once_and_again_when_it_changes(photos: Photos, clock: Clock, way: Callable) -> None:
    clock.ahead = SETTLED * 2
    assert photos.is_right()
    assert sorted(photos.read) == NAMES
    assert photos.is_right()
    assert len(photos.read) == 3, "all are known"
    photos.await_tick()
    way(photos, "a.jpg", CONTENTS[1])
    photos.read.clear()
    assert photos.is_right()
    assert {"a.jpg"} <= set(photos.read) <= {"a.jpg", "b.jpg"}
    photos.read.clear()
    assert photos.is_right()
    assert photos.read == []


def test_what_has_just_changed_or_changes_in_the_future_is_not_trusted(photos: Photos, clock: Clock) -> None:
    for ahead in (0, SETTLED // 2, -SETTLED):
        clock.ahead = ahead
        photos.read.clear()
        assert photos.is_right()
        assert sorted(photos.read) == NAMES


def test_a_photo_from_the_future_is_read_once(photos: Photos, clock: Clock) -> None:
    """A camera with a wrong clock writes such a modification time; a change time cannot be set."""
    clock.ahead = SETTLED * 2
    os.utime(photos.folder / "a.jpg", ns=(0, time.time_ns() + SETTLED * 100))
    assert photos.is_right()
    photos.read.clear()
    assert photos.is_right()
    assert photos.read == []
    photos.await_tick()
    replace_with_old_times(photos, "a.jpg", CONTENTS[1])
    assert photos.is_right()
    assert photos.read == ["a.jpg"]


def test_what_was_read_before_an_interruption_is_not_read_again(
    photos: Photos, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock.ahead = SETTLED * 2
    digest = external_cache.file_digest

    def interrupted(file: BufferedReader, algorithm: str) -> object:
        if len(photos.read) == 2:
            raise KeyboardInterrupt
        return digest(file, algorithm)

    monkeypatch.setattr(external_cache, "file_digest", interrupted)
    with pytest.raises(KeyboardInterrupt):
        photos.cache.digest(photos.folder)
    monkeypatch.setattr(external_cache, "file_digest", digest)
    assert photos.is_right()
    assert sorted(photos.read) == NAMES, "each once"


def test_times_alone_change_no_digest(photos: Photos) -> None:
    before = photos.cache.digest(photos.folder)
    for name in NAMES:
        (photos.folder / name).touch()
    photos.folder.rename(photos.root / "elsewhere")
    assert photos.cache.digest(photos.root / "elsewhere") == before


def test_a_file_that_changes_while_it_is_read_is_refused(photos: Photos, monkeypatch: pytest.MonkeyPatch) -> None:
    digest = external_cache.file_digest

    def slow(file: BufferedReader, algorithm: str) -> object:
        photos.await_tick()
        photos.write(NAMES[0], CONTENTS[1])
        return digest(file, algorithm)

    monkeypatch.setattr(external_cache, "file_digest", slow)
    with pytest.raises(UserError, match="changed while it was being read"):
        photos.cache.digest(photos.folder / NAMES[0])


@pytest.mark.parametrize("damage", ["", "[]", "{", '{"a": 1}', '{"a": ["x", 2]}', '{"a": []}'])
def test_a_damaged_memory_is_no_memory(photos: Photos, clock: Clock, damage: str) -> None:
    clock.ahead = SETTLED * 2
    assert photos.is_right()
    (memory,) = (photos.store.root / "cache/external").iterdir()
    memory.write_text(damage)
    assert photos.is_right()


def test_only_the_owner_can_read_names(photos: Photos, clock: Clock) -> None:
    clock.ahead = SETTLED * 2
    photos.cache.digest(photos.folder)
    paths = [photos.store.root / "external", photos.store.root / "cache/external"]
    for path in [*paths, *(file for folder in paths for file in folder.iterdir())]:
        assert stat.S_IMODE(path.stat().st_mode) & 0o077 == 0, path


@pytest.mark.skipif(sys.platform != "linux", reason="other systems refuse such names")
def test_names_that_are_no_text(photos: Photos) -> None:
    strange = os.fsdecode(b"\xff\xfe.jpg")
    before = photos.cache.digest(photos.folder)
    photos.write(strange, CONTENTS[0])
    after = photos.cache.digest(photos.folder)
    assert after != before
    known = photos.cache.contents(after)
    assert known is not None
    assert strange in known.files
    (listing,) = [path for path in (photos.store.root / "external").iterdir() if after in path.name]
    assert strange in json.loads(listing.read_bytes())["files"]


@pytest.mark.parametrize("inside", [".", "deep/in/it"])
def test_a_folder_that_the_store_lies_in_is_refused(tmp_path: Path, inside: str) -> None:
    """What a run writes would change it for ever; a folder inside a store is as good as any other."""
    (tmp_path / "photos").mkdir()
    (tmp_path / "link").symlink_to("photos")
    store = Store(tmp_path / "photos" / inside / "store")
    for path in (tmp_path / "photos", tmp_path / "link"):
        with pytest.raises(UserError, match=r"contains the store, which changes .*Put the store elsewhere, with"):
            ExternalCache(store).digest(path)
    made = store.root / "latest"
    made.mkdir(parents=True)
    (made / "a.jpg").write_bytes(b"a")
    assert ExternalCache(store).digest(made) == contents_of(made).digest


def test_a_workflow_is_not_planned_with_a_folder_that_the_store_lies_in(workspace: Workspace) -> None:
    workspace.write("stages:\n  a: {uses: numbers, with: {file: .}}\n")
    (problem,) = workspace.problems()
    assert problem.startswith(f"2:35: parameter 'file': {workspace.folder}: contains the store")
    assert not (workspace.folder / "store/external").exists()
