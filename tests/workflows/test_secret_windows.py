"""The search for pieces of a secret finds each one, and nothing where there is none."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.artifact import create, load
from tests.workflows.secret_windows import WINDOW, SecretWindows, everything_in, pieces_of

SECRET = np.random.default_rng(0).standard_normal(500).astype(np.float32).tobytes()
WINDOWS = SecretWindows([SECRET])

starts = st.integers(0, len(SECRET) - WINDOW)
surroundings = st.binary(max_size=40)


@settings(max_examples=60, deadline=None)
@given(starts, surroundings, surroundings)
def test_any_window_is_found_raw(start: int, before: bytes, after: bytes) -> None:
    assert WINDOWS.first_in(before + SECRET[start : start + WINDOW] + after) is not None


@settings(max_examples=60, deadline=None)
@given(starts, surroundings, surroundings, st.booleans(), st.sampled_from([0, 7, 76]))
def test_any_window_is_found_in_base64(start: int, before: bytes, after: bytes, of_urls: bool, width: int) -> None:
    encode = base64.urlsafe_b64encode if of_urls else base64.b64encode
    text = encode(before + SECRET[start : start + WINDOW] + after)
    lines = b"\n".join(text[place : place + width] for place in range(0, len(text), width)) if width else text
    assert WINDOWS.first_in(b'<img src="data:image/png;base64,' + lines + b'">') is not None


def test_one_byte_less_is_no_window() -> None:
    assert WINDOWS.first_in(b"#" + SECRET[40 : 40 + WINDOW - 1] + b"#") is None


@settings(max_examples=30, deadline=None)
@given(st.binary(max_size=3000))
def test_other_bytes_hold_nothing(data: bytes) -> None:
    assert WINDOWS.first_in(data) is None
    assert WINDOWS.first_in(base64.b64encode(data)) is None


def test_fillings_are_nobodys() -> None:
    filled = SecretWindows([np.array([0, 0, 1, 0, 0, 0, 1, 1], np.float32).tobytes(), b"\xff" * 100, b"short"])
    assert filled.first_in(np.zeros(1000, np.float32).tobytes() + np.eye(9, dtype=np.float32).tobytes()) is None
    assert filled.first_in(b"\xff" * 500 + b"A" * 500) is None


@pytest.mark.parametrize("where", ["array", "file"])
def test_pieces_come_from_arrays_and_files(tmp_path: Path, where: str) -> None:
    """The numbers of a compressed array are found wherever they occur, and so is the chunk as it is stored."""
    values = np.random.default_rng(1).standard_normal(64).astype(np.float32)
    with create(tmp_path / "secret", "secret", private=True) as writer:
        writer.write("weights", values)
        writer.write_file("note.txt", "the words that open it")
    secret = load(tmp_path / "secret")
    windows = SecretWindows(pieces_of(secret))
    planted = {"array": values[5:12].tobytes(), "file": b"...words that open it..."}[where]
    with create(tmp_path / "public", "report") as writer:
        writer.write("table", np.frombuffer(planted, np.uint8))
    held = [name for name, data in everything_in(load(tmp_path / "public")) if windows.first_in(data) is not None]
    assert any(name.endswith(": table") for name in held), held
    (chunk,) = [path for path in secret.path.rglob("c*/*") if path.is_file()]
    assert windows.first_in(chunk.read_bytes()) is not None
