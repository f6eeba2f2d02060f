"""Random damage: whatever bytes, files and folders of a store are altered, results are right or not given."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import CorruptArtifact, PipelineError
from pipeline.store.store import Store
from tests.pipeline.helpers import CHAIN, Ran, Workspace

RESULTS = [("base", "numbers"), ("twice", "numbers"), ("other", "numbers"), ("sum", "total"), ("sum", "key")]
VALUES = {"base": [0, 1, 2], "twice": [0, 2, 4], "other": [0, 5, 10]}
Damage = Callable[[Path, random.Random], None]


def flip(path: Path, chance: random.Random) -> None:
    data = bytearray(path.read_bytes())
    for _ in range(chance.choice([1, 1, 1, 5])):
        if data:
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    path.write_bytes(data)


def digit(path: Path, chance: random.Random) -> None:
    """Replaces a digit by another, so that JSON stays JSON."""
    data = bytearray(path.read_bytes())
    places = [place for place, byte in enumerate(data) if 48 <= byte <= 57]
    if places:
        data[chance.choice(places)] = chance.randrange(48, 58)
    path.write_bytes(data)


def shorten(path: Path, chance: random.Random) -> None:
    path.write_bytes(path.read_bytes()[: chance.randrange(path.stat().st_size + 1)])


def overwrite(path: Path, chance: random.Random) -> None:
    path.write_bytes(chance.choice([b"", b"null", b"[]", b"{}", b"[" * 100_000, b"\xff" * 50, chance.randbytes(200)]))


def delete(path: Path, chance: random.Random) -> None:
    path.unlink()


def make_folder(path: Path, chance: random.Random) -> None:
    path.unlink()
    path.mkdir()


def make_link(path: Path, chance: random.Random) -> None:
    path.unlink()
    path.symlink_to(chance.choice(["/dev/zero", *map(str, outside(path)), path.name]))


def outside(path: Path) -> tuple[Path, Path]:
    """A file beside the store that `path` is in, and one that does not exist: neither may be touched."""
    beside = next(parent for parent in path.parents if parent.name == "store").parent
    return beside / "a stranger's", beside / "nowhere"


def delete_folder(path: Path, chance: random.Random) -> None:
    shutil.rmtree(path.parent)


def swap(path: Path, chance: random.Random) -> None:
    """Swaps the contents with another file of the same name."""
    others = sorted(other for other in path.parents[2].rglob(path.name) if other.is_file() and not other.is_symlink())
    if others:
        data, other = path.read_bytes(), chance.choice(others)
        path.write_bytes(other.read_bytes())
        other.write_bytes(data)


KINDS: tuple[Damage, ...] = (
    flip,
    flip,
    digit,
    digit,
    shorten,
    overwrite,
    delete,
    make_folder,
    make_link,
    delete_folder,
    swap,
)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    workspace = Workspace(tmp_path_factory.mktemp("sound")).write(CHAIN)
    workspace.run()
    return workspace


def damaged_copy(sound: Workspace, folder: Path, seed: int, times: int) -> Workspace:
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(sound.folder, folder, symlinks=True)
    (folder / "a stranger's").write_text("kept")
    chance = random.Random(seed)
    for _ in range(times):
        files = sorted(path for path in (folder / "store").rglob("*") if path.is_file() and not path.is_symlink())
        if not files:  # the folder that was deleted was the store, with its .gitignore
            break
        chance.choice(KINDS)(chance.choice(files), chance)
    return Workspace(folder, sound.package)


def wrong_or_unreadable(ran: Ran) -> list[str]:
    """Digests of the results that cannot be read; fails if one that can be read is wrong."""
    unreadable = []
    for name, output in RESULTS:
        try:
            found = ran.values(name, output)
        except CorruptArtifact:
            unreadable.append(ran.ended[name].outputs[output].name)
            continue
        np.testing.assert_array_equal(found, VALUES.get(name) or ([6, 15] if output == "total" else [21]))
    return unreadable


def check_damage(sound: Workspace, folder: Path, seed: int, times: int) -> None:
    workspace = damaged_copy(sound, folder, seed, times)
    with suppress(PipelineError, OSError):  # the command line reports these in one line
        check_repair(workspace, folder)
    strangers, nowhere = outside(folder / "store" / "a file")
    assert strangers.read_text() == "kept"
    assert not nowhere.exists()


def check_repair(workspace: Workspace, folder: Path) -> None:
    workspace.plan()
    ran = workspace.run()
    if any(event.state == "failed" for event in ran.ended.values()):
        return
    store = Store(folder / "store")
    for digest in wrong_or_unreadable(ran):
        store.set_aside(digest)  # as `verify` does
    again = workspace.run()
    if all(state in ("ran", "cached") for state in again.states.values()):
        assert not wrong_or_unreadable(again)
    else:
        assert all(event.cause for event in again.ended.values() if event.state == "failed")
    workspace.plan("factor=3.0")


EXAMPLES = settings(deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


@settings(EXAMPLES, max_examples=20)
@given(seed=st.integers(0, 2**32), times=st.integers(1, 3))
def test_random_damage(sound: Workspace, tmp_path_factory: pytest.TempPathFactory, seed: int, times: int) -> None:
    check_damage(sound, tmp_path_factory.getbasetemp() / "damaged", seed, times)


@pytest.mark.slow
@settings(EXAMPLES, max_examples=2000, derandomize=False)
@given(seed=st.integers(0, 2**32), times=st.integers(1, 6))
def test_much_random_damage(sound: Workspace, tmp_path_factory: pytest.TempPathFactory, seed: int, times: int) -> None:
    check_damage(sound, tmp_path_factory.getbasetemp() / "damaged", seed, times)
