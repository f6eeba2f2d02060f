"""Pictures in arrays and files: which there are, and that the PNG files have the same pixels."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.artifact import Artifact, ArtifactWriter, create, load
from pipeline.errors import CommandError, CorruptArtifact
from pipeline.results.pictures import pictures_of, write_pictures

RANDOM = np.random.default_rng(0)


@contextmanager
def writing(folder: Path, private: bool = False) -> Iterator[ArtifactWriter]:
    with create(folder / "artifact", "views", private) as writer:
        yield writer


def written(folder: Path, most: int | None = None, name: str = "out") -> dict[str, np.ndarray]:
    paths, _ = write_pictures(load(folder / "artifact"), folder / name, most)
    return {path.name: np.asarray(Image.open(path)) for path in paths}


def test_colours_and_greys_pixel_by_pixel(tmp_path: Path) -> None:
    colours = RANDOM.integers(0, 256, (2, 20, 24, 3), np.uint8)
    grey = RANDOM.integers(0, 256, (20, 24), np.uint8)
    clear = RANDOM.integers(0, 256, (20, 24, 4), np.uint8)
    shares = RANDOM.random((1, 2, 20, 24), np.float32)
    mask = RANDOM.random((20, 24)) > 0.5
    with writing(tmp_path) as writer:
        writer.write("set/colours", colours)
        writer.write("grey", grey)
        writer.write("clear", clear)
        writer.write("shares", shares)
        writer.write("mask", mask)
    found = written(tmp_path)
    assert sorted(found) == [
        "clear.png",
        "grey.png",
        "mask.png",
        "set-colours-0.png",
        "set-colours-1.png",
        "shares-0-0.png",
        "shares-0-1.png",
    ]
    np.testing.assert_array_equal(found["set-colours-1.png"], colours[1])
    np.testing.assert_array_equal(found["grey.png"], grey)
    np.testing.assert_array_equal(found["clear.png"], clear)
    np.testing.assert_array_equal(found["shares-0-1.png"], np.rint(shares[0, 1].astype(np.float64) * 255))
    np.testing.assert_array_equal(found["mask.png"], mask * np.uint8(255))


def test_values_beyond_0_and_1(tmp_path: Path) -> None:
    """Colours are clipped; depths and the like are scaled, with one scale for all pictures of an array."""
    depths = np.linspace(2.0, 12.0, 2 * 20 * 20).reshape(2, 20, 20)
    colours = np.full((20, 20, 3), 1.5)
    colours[0, 0] = [-1.0, np.nan, 0.5]
    with writing(tmp_path) as writer:
        writer.write("depths", depths)
        writer.write("colours", colours)
    found = written(tmp_path)
    assert (found["depths-0.png"][0, 0], found["depths-1.png"][-1, -1]) == (0, 255)
    assert found["depths-0.png"][-1, -1] == 127
    assert found["colours.png"][0, 0].tolist() == [0, 0, 128]
    assert found["colours.png"][1, 1].tolist() == [255, 255, 255]


def test_what_is_no_picture(tmp_path: Path) -> None:
    with writing(tmp_path) as writer:
        writer.write("features", np.zeros((9000, 16), np.float32))
        writer.write("harmonics", np.zeros((9000, 16, 3), np.float32))
        writer.write("weights", np.zeros((32, 32, 3, 3), np.float32))
        writer.write("poses", np.zeros((24, 4, 4)))
        writer.write("points", np.zeros((500, 3), np.uint8))
        writer.write("labels", np.zeros((20, 20), np.int64))
        writer.write("none", np.zeros((0, 20, 20, 3), np.uint8))
    assert pictures_of(load(tmp_path / "artifact")) == []
    assert write_pictures(load(tmp_path / "artifact"), tmp_path / "out", 16) == ([], 0)
    assert not (tmp_path / "out").exists()


def test_files_are_copied_as_they_are(tmp_path: Path) -> None:
    with writing(tmp_path) as writer:
        writer.write_file("pictures/a b.JPG", b"jpeg")
        writer.write_file("notes.txt", "words")
    (path,), number = write_pictures(load(tmp_path / "artifact"), tmp_path / "out", 16)
    assert (path.name, path.read_bytes(), number) == ("pictures-a b.JPG", b"jpeg", 1)


def test_a_few_are_drawn_evenly_from_all(tmp_path: Path) -> None:
    with writing(tmp_path) as writer:
        writer.write("a", np.zeros((80, 16, 16), np.uint8))
        writer.write("b", np.zeros((80, 16, 16), np.uint8))
    assert sorted(written(tmp_path, 4)) == ["a-00.png", "a-40.png", "b-00.png", "b-40.png"]
    assert sorted(written(tmp_path, 5, "five")) == ["a-00.png", "a-40.png", "b-00.png", "b-40.png"]
    assert write_pictures(load(tmp_path / "artifact"), tmp_path / "all", None)[1] == 160
    assert len(list((tmp_path / "all").iterdir())) == 160


def test_what_was_rendered_is_drawn_with_its_truth(tmp_path: Path) -> None:
    with writing(tmp_path) as writer:
        for name in ("0/rendered", "0/truth", "1/rendered", "1/truth"):
            writer.write(name, np.zeros((9, 16, 16), np.uint8))
        writer.write("mask", np.zeros((3, 16, 16), np.uint8))
    found = {name.rsplit("-", 1)[1] for name in written(tmp_path, 16)}
    assert len(found) >= 3
    assert {f"{array}-{place}" for place in found for array in ("0-rendered", "0-truth", "1-rendered", "1-truth")} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }


@pytest.mark.parametrize("most", [1, 2, 3, 7])
def test_more_arrays_than_pictures_are_asked_for(tmp_path: Path, most: int) -> None:
    with writing(tmp_path) as writer:
        for name in "abcde":
            writer.write(name, np.zeros((2, 16, 16), np.uint8))
    assert 0 < len(written(tmp_path, most)) <= most


def test_what_is_there_is_not_written_over(tmp_path: Path) -> None:
    """Pictures of another artifact may have the same names, and could not be told apart."""
    with writing(tmp_path) as writer:
        writer.write("a", np.zeros((3, 16, 16), np.uint8))
    (tmp_path / "out").mkdir()
    (tmp_path / "out/a-1.png").write_text("kept")
    with pytest.raises(CommandError, match=r"out/a-1\.png: a picture with this name already exists"):
        written(tmp_path)
    assert [(path.name, path.read_text()) for path in (tmp_path / "out").iterdir()] == [("a-1.png", "kept")]


def test_private_pictures_are_closed(tmp_path: Path) -> None:
    with writing(tmp_path, private=True) as writer:
        writer.write("a", np.zeros((2, 16, 16), np.uint8))
        writer.write_file("b.png", b"png")
    paths, _ = write_pictures(load(tmp_path / "artifact"), tmp_path / "deep" / "out", 16)
    assert {stat.S_IMODE(path.stat().st_mode) for path in paths} == {0o600}
    assert {stat.S_IMODE(path.stat().st_mode) for path in (paths[0].parent, paths[0].parents[1])} == {0o700}


def test_a_damaged_chunk_is_told(tmp_path: Path) -> None:
    with writing(tmp_path) as writer:
        writer.write("a", RANDOM.integers(0, 256, (2, 32, 32, 3), np.uint8))
    artifact: Artifact = load(tmp_path / "artifact")
    chunk = artifact.path / "arrays.zarr/a/c/0/0/0/0"
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 1
    chunk.write_bytes(data)
    with pytest.raises(CorruptArtifact, match="cannot be read"):
        write_pictures(artifact, tmp_path / "out", 16)
