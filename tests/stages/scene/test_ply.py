"""PLY tables are read back bit for bit, by plyfile too, and a broken file gives a one-line error."""

from __future__ import annotations

import os
import re
import tracemalloc
from pathlib import Path

import numpy as np
import plyfile
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pipeline.errors import UserError
from stages.scene.ply.header import LARGEST_HEADER, TYPES
from stages.scene.ply.reading import read_ply
from stages.scene.ply.writing import write_ply

DTYPES = sorted({dtype.str for dtype in TYPES.values()})
NAMES = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=12)
VALID = b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\nend_header\n"
ROWS = np.arange(4, dtype="<f4").tobytes()
TEXT = VALID.replace(b"binary_little_endian", b"ascii")
LISTS = b"element face 1\nproperty list uchar int i\n"

fuzzed = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@st.composite
def tables(draw: st.DrawFn) -> dict[str, np.ndarray]:
    count = draw(st.integers(0, 40))
    names = draw(st.lists(NAMES, min_size=1, max_size=6, unique=True))
    return {name: draw(arrays.arrays(draw(st.sampled_from(DTYPES)), count)) for name in names}


def same_bits(first: np.ndarray, second: np.ndarray) -> bool:
    return first.dtype == second.dtype and first.tobytes() == second.tobytes()


def broken(tmp_path: Path, content: bytes) -> str:
    """The error for a file with this content."""
    path = tmp_path / "stranger.ply"
    path.write_bytes(content)
    with pytest.raises(UserError) as raised:
        read_ply(path).floats("vertex", ["x", "y"])
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 1500
    return str(raised.value)


@given(columns=tables(), comments=st.lists(NAMES, max_size=3))
@fuzzed
def test_what_is_written_comes_back_bit_for_bit(
    tmp_path: Path, columns: dict[str, np.ndarray], comments: list[str]
) -> None:
    write_ply(tmp_path / "table.ply", columns, comments)
    ply = read_ply(tmp_path / "table.ply")
    assert ply.comments == tuple(comments)
    rows = ply.rows("vertex")
    assert rows.dtype.names == tuple(columns)
    for name, column in columns.items():
        assert same_bits(rows[name], column)


@given(columns=tables())
@fuzzed
def test_others_read_it_alike(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    write_ply(tmp_path / "table.ply", columns, ["a comment"])
    theirs = plyfile.PlyData.read(tmp_path / "table.ply")
    assert theirs["vertex"].comments == ["a comment"]
    for name, column in columns.items():
        assert same_bits(np.asarray(theirs["vertex"].data[name]), column)


def test_the_third_line_counts_the_rows_whatever_the_comments(tmp_path: Path) -> None:
    """3DGS's own viewer parses no header: it takes the third word of the third line for the number of Gaussians."""
    write_ply(tmp_path / "table.ply", {"x": np.zeros(12, "<f4")}, ["one two three", "four"])
    assert (tmp_path / "table.ply").read_bytes().split(b"\n")[2] == b"element vertex 12"


def test_rows_of_several_blocks(tmp_path: Path) -> None:
    columns = {name: np.random.default_rng(seed).random(150_000).astype("<f4") for seed, name in enumerate("xyz")}
    write_ply(tmp_path / "table.ply", columns)
    values = read_ply(tmp_path / "table.ply").floats("vertex", ["z", "x"])
    assert same_bits(values, np.stack([columns["z"], columns["x"]], axis=1))
    columns["x"][140_000] = np.nan
    write_ply(tmp_path / "table.ply", columns)
    with pytest.raises(UserError, match="'x' of row 140000 is not finite"):
        read_ply(tmp_path / "table.ply").floats("vertex", ["z", "x"])


@pytest.mark.parametrize(
    ("form", "rows"),
    [
        ("ascii", b"0 1\n2 3\n"),
        ("binary_big_endian", np.arange(4, dtype=">f4").tobytes()),
        ("binary_little_endian", ROWS),
    ],
)
def test_every_format(tmp_path: Path, form: str, rows: bytes) -> None:
    (tmp_path / "any.ply").write_bytes(VALID.replace(b"binary_little_endian", form.encode()) + rows)
    assert read_ply(tmp_path / "any.ply").floats("vertex", ["x", "y"]).tolist() == [[0, 1], [2, 3]]


def test_several_elements_and_old_line_ends(tmp_path: Path) -> None:
    header = VALID.replace(b"end_header\n", b"element chunk 1\nproperty uint8 a\nend_header\n").replace(b"\n", b"\r\n")
    (tmp_path / "two.ply").write_bytes(header + ROWS + b"\x07")
    ply = read_ply(tmp_path / "two.ply")
    assert ply.rows("chunk")["a"].tolist() == [7]
    assert ply.floats("vertex", ["x", "y"]).tolist() == [[0, 1], [2, 3]]


def test_text_may_end_with_its_last_digit(tmp_path: Path) -> None:
    (tmp_path / "text.ply").write_bytes(TEXT + b"0 1\n2 3")
    assert read_ply(tmp_path / "text.ply").floats("vertex", ["x", "y"]).tolist() == [[0, 1], [2, 3]]


@pytest.mark.parametrize("body", [b"", b"\n", b" \r\n\n"])
def test_text_without_rows_may_be_blank(tmp_path: Path, body: bytes) -> None:
    (tmp_path / "text.ply").write_bytes(TEXT.replace(b"vertex 2", b"vertex 0") + body)
    assert read_ply(tmp_path / "text.ply").floats("vertex", ["x", "y"]).shape == (0, 2)


@pytest.mark.parametrize("lists", [b"", LISTS])
@pytest.mark.parametrize(("body", "count"), [(b" " * 20, 0), (b"0.12345\n6.54321\n", 2)])
def test_text_that_lacks_numbers_is_cut_off(tmp_path: Path, lists: bytes, body: bytes, count: int) -> None:
    said = broken(tmp_path, TEXT.replace(b"end_header", lists + b"end_header") + body)
    assert f"a PLY that is cut off; found {count} numbers after the header; expected 4 numbers" in said


def test_integers_of_text_are_read_up_to_the_ends_of_their_type(tmp_path: Path) -> None:
    header = TEXT.replace(b"float x", b"uchar x").replace(b"float y", b"char y")
    (tmp_path / "text.ply").write_bytes(header + b"0 -128\n255 127\n")
    rows = read_ply(tmp_path / "text.ply").rows("vertex")
    assert (rows["x"].tolist(), rows["y"].tolist()) == ([0, 255], [-128, 127])


def test_a_header_of_one_mebibyte_is_the_longest(tmp_path: Path) -> None:
    path, begins = tmp_path / "full.ply", len(VALID) + len("comment \n")
    for length in (2**20, 2**20 + 1):
        comment = b"comment " + b"x" * (length - begins) + b"\n"
        path.write_bytes(VALID.replace(b"end_header", comment + b"end_header") + ROWS)
        if length == 2**20:
            assert read_ply(path).floats("vertex", ["x", "y"]).tolist() == [[0, 1], [2, 3]]
    with pytest.raises(UserError, match=r"header does not end; .* at most 1048576 bytes"):
        read_ply(path)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "not a PLY file; found an empty file"),
        (b"ply", "not a PLY file; found a file that begins with ply; expected a file whose first line is ply"),
        (b"PK\x03\x04 a zip", "not a PLY file; found a zip; expected a file whose first line is ply. Unpack it"),
        (b"\x89PNG", "not a PLY file; found a file that begins with the bytes 89 50 4e 47"),
        (b"ply\n", "header does not end"),
        (VALID.replace(b"end_header", b"end_headers") + ROWS, "header does not end"),
        (b"ply\ncomment " + b"x" * 2 * LARGEST_HEADER + b"\nend_header\n", "header does not end"),
        (VALID.replace(b"format binary_little_endian 1.0\n", b"") + ROWS, "unknown format"),
        (VALID.replace(b"element", b"format ascii 1.0\nelement", 1) + ROWS, "unknown format"),
        (VALID.replace(b"vertex 2", b"vertex 1000000000000000000"), "cut off; found"),
        (VALID.replace(b"vertex 2", b"vertex " + b"9" * 20), "cut off; found"),
        (VALID.replace(b"vertex 2", b"vertex " + b"9" * 21), "line 3 of a PLY's header"),
        (VALID.replace(b"vertex 2", b"vertex " + b"9" * 100_000), "line 3 of a PLY's header"),
        (VALID.replace(b"vertex 2", b"vertex -2"), "line 3 of a PLY's header"),
        (VALID.replace(b"vertex 2", b"vertex 2.0"), "line 3 of a PLY's header"),
        (VALID.replace(b"vertex 2", "vertex ٢".encode()), "line 3 of a PLY's header"),
        (
            VALID.replace(b"float y", b"list uchar int y") + ROWS,
            "'vertex' of a PLY cannot be read; found lists in 'vertex'",
        ),
        (
            VALID.replace(b"element", b"element face 0\nproperty list uchar int i\nelement", 1) + ROWS,
            "'vertex' of a PLY cannot be read; found lists in 'face'",
        ),
        (VALID.replace(b"float y", b"float128 y") + ROWS, "line 5 of a PLY's header"),
        (VALID.replace(b"float y", b"float x") + ROWS, "line 5 of a PLY's header"),
        (VALID.replace(b"float y", b"float " + b"y" * 100) + ROWS, "1 of 2 properties .* missing"),
        (VALID.replace(b"float y", b"float " + b"y" * 101) + ROWS, "line 5 of a PLY's header"),
        (VALID.replace(b"float y", b"float " + b"y" * 500_000) + ROWS, "line 5 of a PLY's header"),
        (VALID.replace(b"element vertex 2\n", b"") + ROWS, "line 3 of a PLY's header"),
        (VALID.replace(b"end_header", b"element vertex 1\nend_header"), "line 6 of a PLY's header"),
        (VALID.replace(b"end_header", b"element face 9\nend_header") + ROWS, "'face' of a PLY has no properties"),
        (VALID.replace(b"vertex", b"face") + ROWS, "without the element 'vertex'"),
        (b"ply\nformat binary_little_endian 1.0\nend_header\n", "without the element 'vertex'"),
        (VALID.replace(b"float y", b"float z") + ROWS, "1 of 2 properties .* missing; found no y among x, z"),
        (VALID.replace(b"float y", b"int y") + ROWS, "'y' is of another type; found int; expected float"),
        (VALID.replace(b"float y", b"double y") + bytes(24), "'y' is of another type; found double; expected float"),
        (VALID + ROWS[:-1], "cut off; found 15 bytes after the header; expected 16 bytes for 2 rows of vertex"),
        (VALID + ROWS + b"\0", "longer than its header says"),
        (TEXT + b"0 1\n2.0", "cut off; found 3 numbers after the header; expected 4 numbers for 2 rows of vertex"),
        (TEXT + b"0 1\n2 3\n4", "longer than its header says"),
        (
            TEXT.replace(b"vertex 2", b"vertex 1000000000").replace(b"end_header", LISTS + b"end_header") + b"0 1\n",
            "cut off; found 4 bytes after the header",
        ),
        (TEXT.replace(b"float y", b"uchar y") + b"0 1\n2 256", "y of vertex holds numbers that its type does not"),
        (TEXT.replace(b"float y", b"uchar y") + b"0 1\n2 2.5", "y of vertex holds numbers that its type does not"),
        (TEXT.replace(b"float y", b"char y") + b"0 1\n2 -129", "y of vertex holds numbers that its type does not"),
        (VALID + ROWS[:8] + np.array([np.nan, 0], "<f4").tobytes(), "'x' of row 1 is not finite; found nan"),
        (VALID + ROWS[:8] + np.array([0, -np.inf], "<f4").tobytes(), "'y' of row 1 is not finite; found -inf"),
    ],
)
def test_what_is_broken_is_told_in_one_line(tmp_path: Path, content: bytes, told: str) -> None:
    said = broken(tmp_path, content)
    assert re.search(told, said), said


def test_what_is_no_file_is_told(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nothing.ply"):
        with pytest.raises(UserError, match="no such PLY file"):
            read_ply(path)
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(UserError, match="no such PLY file"):
        read_ply(tmp_path / "pipe.ply")


@given(place=st.integers(0, len(VALID + ROWS) - 1), replaced=st.integers(0, 30), by=st.binary(max_size=30))
@fuzzed
def test_damage_is_an_answer_or_one_error(tmp_path: Path, place: int, replaced: int, by: bytes) -> None:
    content = VALID + ROWS
    (tmp_path / "damaged.ply").write_bytes(content[:place] + by + content[place + replaced :])
    said = ""
    try:
        values = read_ply(tmp_path / "damaged.ply").floats("vertex", ["x", "y"])
        assert np.isfinite(values).all()
    except UserError as error:
        said = str(error)
    assert "\n" not in said


@pytest.mark.parametrize(
    "line",
    [b"property float %d\n", b"element %d 0\nproperty char a\n", b"comment %d\n", b"\n%.0a"],
    ids=["properties", "elements", "comments", "empty"],
)
def test_a_full_header_takes_little_memory(tmp_path: Path, line: bytes) -> None:
    """With as many lines as a header can hold, memory stays in proportion to them, whatever they claim."""
    lines = b"".join(line % number for number in range(LARGEST_HEADER // len(line % 99999)))
    path = tmp_path / "full.ply"
    path.write_bytes(VALID.replace(b"end_header", lines + b"end_header") + ROWS)
    said = ""
    tracemalloc.start()
    try:
        read_ply(path)
    except UserError as error:
        said = str(error)
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert len(said) < 1500
    assert peak < 100 * 2**20


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize(
    ("columns", "comments", "told"),
    [
        ({}, [], "different lengths"),
        ({"x": np.zeros(2, "f4"), "y": np.zeros(3, "f4")}, [], "different lengths"),
        ({"x": np.zeros((2, 2), "f4")}, [], "different lengths"),
        ({"x": np.zeros(2, "f2")}, [], "no type for float16"),
        ({"x y": np.zeros(2, "f4")}, [], "cannot name"),
        ({"x": np.zeros(2, "f4")}, ["a\nend_header"], "one line"),
        ({"x": np.zeros(2, "f4")}, ["a" * LARGEST_HEADER], "can be read again"),
    ],
)
def test_what_ply_cannot_hold_is_refused(tmp_path: Path, columns: dict, comments: list, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        write_ply(tmp_path / "table.ply", columns, comments)
    assert not (tmp_path / "table.ply").exists()
