"""Tensors too large for the free memory are refused with a message: the system would kill the process on access."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

from opencl import free_memory, pool

GIB = 2**30


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(free_memory, "SYSTEM", tmp_path / "meminfo")
    monkeypatch.setattr(free_memory, "CONTROL_GROUP", tmp_path)
    return tmp_path


def test_of_the_machine(told: Path) -> None:
    (told / "meminfo").write_text("MemTotal:  8000 kB\nMemAvailable:   3000 kB\n")
    assert free_memory.free_memory() == 3000 * 1024


def test_of_a_container_with_what_it_would_let_go(told: Path) -> None:
    (told / "meminfo").write_text("MemAvailable:   9000 kB\n")
    (told / "memory.max").write_text("1000000\n")
    (told / "memory.current").write_text("900000\n")
    (told / "memory.stat").write_text("anon 5\nactive_file 20000\ninactive_file 30000\n")
    assert free_memory.free_memory() == 150_000
    (told / "memory.max").write_text("max\n")
    assert free_memory.free_memory() == 9000 * 1024


def test_where_nothing_is_told_nothing_is_refused(told: Path) -> None:
    assert free_memory.free_memory() is None
    assert pool.empty(4, dtype=torch.float32).shape == (4,)


def test_what_there_is_no_room_for_is_refused_with_a_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "free_memory", lambda: 3 * GIB)
    with pytest.raises(RuntimeError, match=r"no room for 4.00 GiB: 3.00 are free. Take a smaller picture"):
        pool.empty(GIB, dtype=torch.float32)


def test_what_the_system_refuses_is_refused_with_a_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The system may have a limit that cannot be read beforehand, such as ulimit's."""

    def no_room(size: int, dtype: type) -> None:
        raise MemoryError("Unable to allocate")

    monkeypatch.setattr(pool, "_pool", pool._Pool())
    monkeypatch.setattr(pool.np, "empty", no_room)
    with pytest.raises(RuntimeError, match=f"no room for 0.00 GiB: Unable to allocate. {re.escape(pool.WAY_OUT)}"):
        pool.empty(1 << 20, dtype=torch.float32)


def test_small_ones_do_not_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "free_memory", lambda: 0)
    assert pool.empty(1000, 1000, dtype=torch.float32).shape == (1000, 1000)
