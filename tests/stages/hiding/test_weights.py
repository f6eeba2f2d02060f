"""Weights come back bit for bit; a stranger's file is read or gives one error, in bounded memory."""

from __future__ import annotations

import json
import os
import re
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pipeline.errors import UserError
from stages.hiding import weights as module
from stages.hiding.weights import LARGEST_HEADER, read_weights, weights_file

VALUES = st.floats(width=32, allow_nan=False, allow_infinity=False)
SHAPES = arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)
WEIGHTS = st.dictionaries(
    st.text(max_size=10), SHAPES.flatmap(lambda shape: arrays.arrays("<f4", shape, elements=VALUES))
)
TWO = weights_file({"0.weight": np.ones((2, 2), np.float32), "0.bias": np.zeros(2, np.float32)})

fuzzed = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def file_of(header: Any, data: bytes = b"", length: int | None = None) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return (len(text) if length is None else length).to_bytes(8, "little") + text + data


def tensor(kind: str, shape: list[int], start: int, end: int) -> dict[str, Any]:
    return {"dtype": kind, "shape": shape, "data_offsets": [start, end]}


@given(weights=WEIGHTS.filter(lambda weights: "__metadata__" not in weights))
@fuzzed
def test_weights_come_back_bit_for_bit(tmp_path: Path, weights: dict[str, np.ndarray]) -> None:
    (tmp_path / "network.safetensors").write_bytes(weights_file(weights))
    again = read_weights(tmp_path / "network.safetensors")
    assert again.keys() == weights.keys()
    for name, values in weights.items():
        assert again[name].shape == values.shape
        assert again[name].tobytes() == values.tobytes()
    assert weights_file(dict(reversed(weights.items()))) == weights_file(weights)


FOUR = bytes(4)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "cut off"),
        (b"\x01\x02", "cut off"),
        (file_of({}, length=2**64 - 1), "cut off"),
        (file_of({}, length=3), "cut off"),
        (file_of(b" " * (LARGEST_HEADER + 1)), "would be the header"),
        (file_of(b"no JSON"), "cannot be read"),
        (file_of(b"[" * 100_000), "cannot be read"),
        (file_of(b'{"a":' * 100_000), "cannot be read"),
        (file_of({"a": tensor("F32", [1], 0, 4), "b": tensor("F32", [1], 0, 4)}, FOUR), "cannot be read"),
        (file_of({"a": tensor("F32", [2], 0, 8), "b": tensor("F32", [1], 4, 8)}, bytes(8)), "cannot be read"),
        (file_of({"a": tensor("F32", [1], 4, 8)}, bytes(8)), "cannot be read"),
        (file_of({"a": tensor("F32", [1], 0, 4)}, bytes(8)), "cannot be read"),
        (file_of({"a": tensor("F32", [2], 0, 8)}, FOUR), "cannot be read"),
        (file_of({"a": tensor("F32", [2**40, 2**40], 0, 4)}, FOUR), "cannot be read"),
        (file_of({"a": tensor("F32", [2**62, 0, 2**62], 0, 0)}), "cannot be read"),
        (file_of({"a": tensor("F32", [-1], 0, 4)}, FOUR), "cannot be read"),
        (file_of({"a": tensor("F32", [1] * 1000, 0, 4)}, FOUR), "cannot be read"),
        (file_of({"a": tensor("BF16", [2], 0, 4)}, FOUR), "cannot be read"),
        (file_of({"a": tensor("F8_E4M3", [4], 0, 4)}, FOUR), "cannot be read"),
        (file_of({"a": tensor("I32", [1], 0, 4)}, FOUR), "'a' .* found type int32; expected .* F32"),
        (file_of({"a": tensor("F64", [1], 0, 8)}, bytes(8)), "'a' .* found type float64"),
        (weights_file({"a": np.array([1, np.nan], np.float32)}), "'a' .* found NaN or infinity"),
        (weights_file({"a": np.array([np.inf], np.float32)}), "'a' .* found NaN or infinity"),
        (TWO[:-1], "cannot be read"),
        (TWO + b"\0", "cannot be read"),
    ],
)
def test_what_is_broken_is_told_in_one_line(tmp_path: Path, content: bytes, told: str) -> None:
    (tmp_path / "stranger.safetensors").write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(UserError) as raised:
            read_weights(tmp_path / "stranger.safetensors")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    said = str(raised.value)
    assert re.search(told, said), said
    assert "stranger.safetensors" in said
    assert "\n" not in said
    assert peak < 20 * 2**20


def test_a_weight_named_twice_is_at_most_its_own_bytes(tmp_path: Path) -> None:
    """The library keeps the last of two entries that claim the same bytes, and refuses two that claim others."""
    one, two = (json.dumps(tensor("F32", [1], start, start + 4)) for start in (0, 4))
    (tmp_path / "same.safetensors").write_bytes(file_of(f'{{"a":{one},"a":{one}}}'.encode(), FOUR))
    assert {name: values.tolist() for name, values in read_weights(tmp_path / "same.safetensors").items()} == {"a": [0]}
    (tmp_path / "other.safetensors").write_bytes(file_of(f'{{"a":{one},"a":{two}}}'.encode(), bytes(8)))
    with pytest.raises(UserError, match="cannot be read"):
        read_weights(tmp_path / "other.safetensors")


def test_a_header_of_one_mebibyte_is_the_longest(tmp_path: Path) -> None:
    for length in (2**20, 2**20 + 1):
        (tmp_path / str(length)).write_bytes(file_of(b"{}".ljust(length)))
    assert read_weights(tmp_path / str(2**20)) == {}
    with pytest.raises(UserError, match=r"1048577 would be the header; expected .* of at most 1048576 bytes"):
        read_weights(tmp_path / str(2**20 + 1))


def test_a_file_of_more_than_a_gibibyte_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large.safetensors"
    path.write_bytes(TWO)
    os.truncate(path, 2**30 + 1)  # a hole, which takes no disk space
    tracemalloc.start()
    try:
        with pytest.raises(UserError, match="too large; found 1073741825; expected at most 1073741824 bytes"):
            read_weights(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 2**20


def test_a_file_of_the_largest_size_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "network.safetensors").write_bytes(TWO)
    monkeypatch.setattr(module, "LARGEST_FILE", len(TWO))
    assert read_weights(tmp_path / "network.safetensors").keys() == {"0.weight", "0.bias"}


def test_what_is_no_file_is_told(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nothing"):
        with pytest.raises(UserError, match="no such file of weights"):
            read_weights(path)


@given(place=st.integers(0, len(TWO) - 1), replaced=st.integers(0, 20), by=st.binary(max_size=20))
@fuzzed
def test_damage_is_an_answer_or_one_error(tmp_path: Path, place: int, replaced: int, by: bytes) -> None:
    (tmp_path / "damaged").write_bytes(TWO[:place] + by + TWO[place + replaced :])
    said = ""
    try:
        weights = read_weights(tmp_path / "damaged")
        assert all(values.dtype == np.float32 and np.isfinite(values).all() for values in weights.values())
    except UserError as error:
        said = str(error)
    assert "\n" not in said
