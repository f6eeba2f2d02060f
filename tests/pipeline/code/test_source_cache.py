"""A module that has been read is not parsed again, and one that has changed always is, however it was changed."""

from __future__ import annotations

import json
import os
import stat
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.code import source_cache
from pipeline.code.fingerprint import Module, read_module
from pipeline.code.source_cache import SourceCache
from pipeline.errors import UserError
from pipeline.store.look import SETTLED
from pipeline.store.store import Store

SOURCE = '"""Draws."""\nimport json\nRESOURCES = ("kernels/*.cl",)\nSIZE = 1\n'


class Package:
    """The module `package.draw` with its kernels, and a store beside it; counts how often it is parsed."""

    def __init__(self, root: Path) -> None:
        self.source = root / "package" / "draw.py"
        self.kernel = root / "package" / "kernels" / "one.cl"
        self.kernel.parent.mkdir(parents=True)
        self.source.write_text(SOURCE)
        self.kernel.write_text("1111")
        self.store = Store(root / "store")
        self.parsed = 0

    def read(self) -> Module:
        """Reads it as a command does, with what earlier commands remembered."""
        cache = SourceCache(self.store, "package")
        module = cache.module("package.draw", self.source)
        cache.remember()
        return module

    def is_right(self) -> bool:
        return self.read() == read_module("package.draw", self.source)

    @property
    def memories(self) -> list[Path]:
        return list((self.store.root / "cache" / "sources").glob("*"))


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Package:
    made = Package(tmp_path)

    def counted(name: str, path: Path, read: Callable[[Path], bytes]) -> Module:
        made.parsed += 1
        return read_module(name, path, read)

    monkeypatch.setattr(source_cache, "read_module", counted)
    return made


class Clock:
    """The reader's clock, `ahead` of the file system's."""

    def __init__(self, ahead: int) -> None:
        self.ahead = ahead

    def time_ns(self) -> int:
        return time.time_ns() + self.ahead


@pytest.fixture
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was just written counts as written long ago."""
    monkeypatch.setattr(source_cache, "time", Clock(SETTLED * 2))


def edit_source(package: Package) -> None:
    package.source.write_text(SOURCE.replace("SIZE = 1", "SIZE = 2"))


def edit_kernel(package: Package) -> None:
    package.kernel.write_text("2222")


def edit_and_restore_times(package: Package) -> None:
    before = package.source.stat()
    edit_source(package)
    os.utime(package.source, ns=(before.st_atime_ns, before.st_mtime_ns))


def rename_over(package: Package) -> None:
    other = package.source.with_name("other")
    other.write_text(SOURCE.replace("SIZE = 1", "SIZE = 2"))
    before = package.source.stat()
    os.utime(other, ns=(before.st_atime_ns, before.st_mtime_ns))
    other.replace(package.source)


def add_kernel(package: Package) -> None:
    package.kernel.with_name("two.cl").write_text("")


def rename_kernel(package: Package) -> None:
    package.kernel.rename(package.kernel.with_name("two.cl"))


def swap_folder(package: Package) -> None:
    package.kernel.parent.rename(package.kernel.parent.with_name("old"))
    package.kernel.parent.mkdir()
    package.kernel.write_text("1112")


def name_no_kernel(package: Package) -> None:
    package.source.write_text(SOURCE.replace('RESOURCES = ("kernels/*.cl",)\n', ""))
    package.kernel.unlink()


EDITS = [
    edit_source,
    edit_kernel,
    edit_and_restore_times,
    rename_over,
    add_kernel,
    rename_kernel,
    swap_folder,
    name_no_kernel,
]


@pytest.mark.usefixtures("settled")
@pytest.mark.parametrize("edit", EDITS)
def test_what_is_settled_is_parsed_once_and_again_when_it_changes(package: Package, edit: Callable) -> None:
    first = package.read()
    assert package.read() == first
    assert package.parsed == 1
    await_tick(package.source)
    edit(package)
    assert package.is_right()
    assert package.read().digest != first.digest
    assert package.parsed == 2


@pytest.mark.parametrize("edit", EDITS)
def test_what_was_just_written_is_never_stale(package: Package, edit: Callable) -> None:
    """Within one tick of the clock, an edit of the same size leaves a file looking as it did."""
    package.read()
    assert not package.memories
    edit(package)
    assert package.is_right()


def test_what_changes_in_the_future_is_not_remembered(package: Package, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_cache, "time", Clock(-SETTLED))
    package.read()
    assert not package.memories


@pytest.mark.usefixtures("settled")
def test_what_says_that_it_was_written_in_the_future_is_remembered(package: Package) -> None:
    os.utime(package.kernel, ns=(0, time.time_ns() + SETTLED * 100))
    assert package.read() == package.read()
    assert package.parsed == 1


@pytest.mark.usefixtures("settled")
def test_a_module_under_another_name_or_path_is_another(package: Package) -> None:
    """Relative imports depend on the name."""
    package.source.write_text("from . import other\n")
    package.read()
    cache = SourceCache(package.store, "package")
    assert cache.module("renamed.draw", package.source).imports == ("renamed", "renamed.other")
    copy = package.source.with_name("copy.py")
    copy.write_text("from . import another\n")
    assert cache.module("package.draw", copy).imports == ("package", "package.another")


@pytest.mark.usefixtures("settled")
def test_another_python_remembers_for_itself(package: Package, monkeypatch: pytest.MonkeyPatch) -> None:
    package.read()
    monkeypatch.setattr(sys, "version", "3.99")
    package.read()
    assert package.parsed == 2
    assert len(package.memories) == 2


@pytest.mark.usefixtures("settled")
def test_what_is_wrong_is_told_again(package: Package) -> None:
    package.read()
    package.kernel.unlink()
    for _ in range(2):
        with pytest.raises(UserError, match="matches no file"):
            package.read()
    package.source.write_text("def")
    for _ in range(2):
        with pytest.raises(UserError, match="not Python"):
            package.read()


@pytest.mark.usefixtures("settled")
@pytest.mark.parametrize("damage", ["", "{}", "[]", "cut", "other digest"])
def test_a_damaged_memory_is_no_memory(package: Package, damage: str) -> None:
    right = package.read()
    (memory,) = package.memories
    text = memory.read_text()
    memory.write_text({"cut": text[:-20], "other digest": text.replace(right.digest, "0" * 64)}.get(damage, damage))
    assert package.read() == right
    assert package.parsed == 2


@pytest.mark.usefixtures("settled")
def test_only_the_owner_can_read_it(package: Package) -> None:
    package.read()
    (memory,) = package.memories
    assert stat.S_IMODE(memory.stat().st_mode) == 0o600
    assert json.loads(memory.read_text())["package.draw"]["resources"] == ["kernels/*.cl"]


def await_tick(path: Path) -> None:
    """Returns when the file system's clock has moved on."""
    before = path.stat().st_ctime_ns
    other = path.with_name("tick")
    while True:
        other.write_text("")
        if other.stat().st_ctime_ns > before:
            other.unlink()
            return
