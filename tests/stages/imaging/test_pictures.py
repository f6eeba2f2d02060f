from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import EpsImagePlugin, Image, ImageFile, ImageOps, UnidentifiedImageError

from pipeline.errors import UserError
from stages.imaging.backgrounds import over_background
from stages.imaging.orientation import AS_VIEWED, UPRIGHT
from stages.imaging.pictures import (
    MOST_PIXELS,
    encode_jpeg,
    encode_png,
    open_picture,
    picture_to_tensor,
    read_picture,
    resize_picture,
    tensor_to_picture,
)
from stages.scene.photo_facts import read_facts
from stages.scene.photo_folder import ANIMATIONS, SUFFIXES


@pytest.fixture
def gradient() -> np.ndarray:
    """A picture so smooth that JPEG hardly changes it, and different in each corner and channel."""
    rows, columns = np.mgrid[0:24, 0:32]
    return np.stack([rows * 10, columns * 7, 255 - rows * 4 - columns * 4], axis=-1).astype(np.uint8)


def test_png_keeps_every_bit(tmp_path: Path, gradient: np.ndarray) -> None:
    path = tmp_path / "picture.png"
    path.write_bytes(encode_png(gradient))
    assert np.array_equal(read_picture(path), gradient)
    assert read_picture(path).dtype == np.uint8


def test_jpeg_stays_close_and_keeps_colour_resolution(gradient: np.ndarray) -> None:
    striped = gradient.copy()
    striped[:, ::2] = [255, 0, 0]
    decoded = np.asarray(Image.open(io.BytesIO(encode_jpeg(striped, 95))))
    assert np.abs(decoded.astype(int) - striped).mean() < 8  # red stripes one pixel wide vanish if colours are halved


@pytest.mark.parametrize("orientation", range(10))
@pytest.mark.parametrize("suffix", ["png", "tiff", "webp"])
def test_exif_orientation_is_applied(tmp_path: Path, gradient: np.ndarray, orientation: int, suffix: str) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"turned.{suffix}"
    Image.fromarray(gradient).save(path, exif=exif, **({"lossless": True} if suffix == "webp" else {}))
    with Image.open(path) as image:
        expected = np.asarray(ImageOps.exif_transpose(image))
    assert np.array_equal(read_picture(path), expected)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("mode", ["L", "I;16", "I;16B", "RGBA"])
def test_exif_turns_tiffs_that_pillow_would_map(
    tmp_path: Path, gradient: np.ndarray, orientation: int, mode: str
) -> None:
    grey = gradient[..., 0]
    deep = grey.astype(np.uint16) * 257
    opaque = np.dstack([gradient, np.full_like(grey, 255)])
    stored = Image.fromarray({"L": grey, "I;16": deep, "I;16B": deep.astype(">u2"), "RGBA": opaque}[mode])
    assert stored.mode == mode
    exif = Image.Exif()
    exif[0x0112] = orientation
    stored.save(tmp_path / "turned.tiff", exif=exif)
    shown = Image.fromarray(gradient if mode == "RGBA" else np.dstack([grey] * 3))
    expected = shown if orientation == UPRIGHT else shown.transpose(AS_VIEWED[orientation])
    assert np.array_equal(read_picture(tmp_path / "turned.tiff"), np.asarray(expected))


@pytest.mark.parametrize("rows", [1, 5, 1000])
def test_a_tiff_that_claims_more_rows_than_it_lists_is_refused(tmp_path: Path, gradient: np.ndarray, rows: int) -> None:
    path, (height, width) = tmp_path / "short.tiff", gradient.shape[:2]
    Image.fromarray(gradient).save(path, tiffinfo={278: rows})
    assert np.array_equal(read_picture(path), gradient)
    tag = struct.pack("<HHI", 257, 4, 1)  # ImageLength
    whole = path.read_bytes()
    assert whole.count(tag + struct.pack("<I", height)) == 1
    path.write_bytes(whole.replace(tag + struct.pack("<I", height), tag + struct.pack("<I", 2 * height)))
    with pytest.raises(UserError, match=f"{width * height} of {2 * width * height} pixels are in the file|cannot be"):
        read_picture(path)


BROKEN_TAGS = {
    "resolution as text": (0x011A, 2, 3, b"72\0"),
    "unit as a real": (0x0128, 11, 1, struct.pack("<f", 2.0)),
}
"""Tag, type, count and value as in the file; what other programs have written into EXIF."""


@pytest.mark.parametrize("broken", BROKEN_TAGS)
def test_a_broken_tag_beside_it_does_not_hide_the_orientation(
    tmp_path: Path, gradient: np.ndarray, broken: str
) -> None:
    tags = sorted([(0x0112, 3, 1, b"\6\0"), BROKEN_TAGS[broken]])
    entries = b"".join(struct.pack("<HHI", *tag[:3]) + tag[3].ljust(4, b"\0") for tag in tags)
    block = b"Exif\0\0II*\0" + struct.pack("<IH", 8, len(tags)) + entries + struct.pack("<I", 0)
    path = tmp_path / "turned.jpg"
    Image.fromarray(gradient).save(path, exif=block)
    assert read_picture(path).shape[:2] == gradient.shape[1::-1]


def test_transparency_is_laid_over_white(tmp_path: Path) -> None:
    pixels = np.array([[[200, 100, 0, 255], [200, 100, 0, 0]]], dtype=np.uint8)
    path = tmp_path / "transparent.png"
    Image.fromarray(pixels).save(path)
    assert read_picture(path).tolist() == [[[200, 100, 0], [255, 255, 255]]]


def test_sixteen_bits_grey_and_palette_become_eight_bit_rgb(tmp_path: Path, gradient: np.ndarray) -> None:
    deep = tmp_path / "deep.png"
    Image.fromarray(np.array([[0, 257 * 100, 65535]], dtype=np.uint16)).save(deep)
    assert read_picture(deep).tolist() == [[[0] * 3, [100] * 3, [255] * 3]]
    for mode in ("L", "P", "1", "LA", "CMYK"):
        path = tmp_path / f"{mode}.tiff"
        Image.fromarray(gradient).convert("L" if mode == "LA" else "RGB").convert(mode).save(path)
        assert read_picture(path).shape == gradient.shape, mode


def png_of_sixteen_bits(colors: np.ndarray, transparent: tuple[int, int, int]) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    height, width = colors.shape[:2]
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in colors)
    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"tRNS", struct.pack(">3H", *transparent)), (b"IDAT", zlib.compress(rows))]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*each) for each in [*chunks, (b"IEND", b"")])


def test_a_colour_that_a_picture_of_16_bits_calls_transparent(tmp_path: Path) -> None:
    colors = np.array([[[40_000, 20_000, 10_000], [10_000, 20_000, 40_000]]], np.uint16)
    path = tmp_path / "deep.png"
    path.write_bytes(png_of_sixteen_bits(colors, transparent=(40_000, 20_000, 10_000)))
    assert read_picture(path).tolist() == [[[255, 255, 255], [39, 78, 156]]]
    over = over_background(path, "black")
    assert over is not None
    assert over.tolist() == [[[0, 0, 0], [39, 78, 156]]]


@pytest.mark.parametrize("file_format", ["PNG", "JPEG"])
def test_truncated_files_are_named(tmp_path: Path, file_format: str) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    path = tmp_path / f"short.{file_format.lower()}"
    Image.fromarray(noise).save(path)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(UserError, match=rf"short\.{file_format.lower()}"):
        read_picture(path)


@pytest.mark.parametrize("content", [b"", b"not a picture", b"\x89PNG\r\n\x1a\n" + bytes(40)])
def test_what_is_no_picture_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "wrong.png"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"wrong\.png"):
        read_picture(path)


def test_floating_point_pictures_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "float.tiff"
    Image.fromarray(np.zeros((2, 2), dtype=np.float32)).save(path)
    with pytest.raises(UserError, match="no defined range"):
        read_picture(path)


@pytest.mark.parametrize("suffix", [*SUFFIXES, *ANIMATIONS])
def test_every_format_that_is_called_a_photo_is_read(tmp_path: Path, gradient: np.ndarray, suffix: str) -> None:
    path = tmp_path / f"picture{suffix}"
    Image.fromarray(gradient).save(path)
    assert read_picture(path).shape == gradient.shape


def test_photos_of_phones_with_a_second_picture_in_them_are_read(tmp_path: Path, gradient: np.ndarray) -> None:
    pictures = [Image.fromarray(gradient), Image.fromarray(gradient[::2, ::2])]
    pictures[0].save(tmp_path / "phone.jpg", "MPO", save_all=True, append_images=pictures[1:])
    assert read_picture(tmp_path / "phone.jpg").shape == gradient.shape


@pytest.mark.parametrize("read", [read_picture, read_facts, open_picture, lambda path: over_background(path, "black")])
def test_a_picture_never_starts_a_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read: Callable[[Path], object]
) -> None:
    """Pillow passes PostScript, whatever the file is called, to any Ghostscript that it finds."""
    started = tmp_path / "started"
    (tmp_path / "gs").write_text(f"#!/bin/sh\n: > {started}\n")
    (tmp_path / "gs").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)
    path = tmp_path / "photo.png"
    path.write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\nshowpage\n")
    with pytest.raises((UserError, UnidentifiedImageError), match=r"photo\.png"):
        read(path)
    assert not started.exists()


def claiming(path: Path, width: int, height: int) -> Path:
    """A PNG of a few bytes whose header claims this size."""
    path.write_bytes(encode_png(np.zeros((1, 1, 3), np.uint8)))
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    whole = path.read_bytes()
    path.write_bytes(whole[:12] + header + struct.pack(">I", zlib.crc32(header)) + whole[33:])
    return path


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("side", [15_000, 30_000])  # less and more than what Pillow refuses
def test_too_many_pixels_are_refused_before_there_is_room_for_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, side: int
) -> None:
    path = claiming(tmp_path / "bomb.png", side, side)
    decoded: list[Image.Image] = []
    monkeypatch.setattr(Image.Image, "load", decoded.append)
    monkeypatch.setattr(ImageFile.ImageFile, "load", decoded.append)
    with pytest.raises(UserError, match=r"bomb\.png.*found .* pixels.*at most 210,000,000 pixels.*save it smaller"):
        read_picture(path)
    assert not decoded


@pytest.mark.parametrize("size", [(12032, 9024), (16320, 12240)])
@pytest.mark.filterwarnings("error")
def test_photos_of_the_largest_cameras_are_not_too_large(tmp_path: Path, size: tuple[int, int]) -> None:
    with open_picture(claiming(tmp_path / "phone.png", *size)) as image:
        assert image.size == size
        assert image.width * image.height <= MOST_PIXELS


def test_a_picture_for_which_there_is_no_memory_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def load(image: Image.Image) -> None:
        raise MemoryError

    path = claiming(tmp_path / "large.png", 10, 10)
    monkeypatch.setattr(ImageFile.ImageFile, "load", load)
    with pytest.raises(UserError, match=r"large\.png.*MemoryError"):
        read_picture(path)


def test_shrinking_takes_the_mean_of_each_area() -> None:
    picture = np.zeros((4, 6, 3), dtype=np.uint8)
    picture[:2, :3] = 90
    picture[2, 3] = 180
    halves = resize_picture(picture, 3, 2)
    assert halves[0, 0].tolist() == [90] * 3
    assert halves[0, 1].tolist() == [45] * 3  # half of this area is 90, half 0
    assert halves[1, 1].tolist() == [45] * 3  # a quarter of it is 180
    thirds = resize_picture(picture, 4, 4)  # areas of one and a half pixels
    assert thirds[0, 1].tolist() == [90] * 3
    assert thirds[0, 2].tolist() == [0] * 3


def test_enlarging_and_keeping_the_size(gradient: np.ndarray) -> None:
    assert resize_picture(gradient, 64, 48).shape == (48, 64, 3)
    same = resize_picture(gradient, 32, 24)
    assert np.array_equal(same, gradient)
    assert same is not gradient
    with pytest.raises(ValueError, match="0 x 5"):
        resize_picture(gradient, 0, 5)


def test_bytes_and_values_convert_both_ways() -> None:
    every = np.arange(256, dtype=np.uint8).reshape(1, 256, 1).repeat(3, axis=2)
    values = picture_to_tensor(every)
    assert values.dtype == torch.float32
    assert float(values.max()) == 1
    assert np.array_equal(tensor_to_picture(values), every)
    assert tensor_to_picture(torch.tensor([-1.0, 0.5, 3.0])).tolist() == [0, 128, 255]


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"\0\0\0\x18ftypheic" + b"\0" * 100, "HEIC or AVIF, whatever the file is called"),
        (b"\0\0\0\x18ftypisom" + b"\0" * 100, "a video or a raw photo, whatever the file is called"),
        (b"", "an empty file"),
        (b"no picture", "none of these formats"),
    ],
)
def test_what_is_no_picture_is_told_by_what_it_is(tmp_path: Path, content: bytes, found: str) -> None:
    (tmp_path / "photo.jpg").write_bytes(content)
    with pytest.raises(UserError, match=f"found {found}; .*Convert it to JPEG") as raised:
        read_picture(tmp_path / "photo.jpg")
    assert str(raised.value).count("photo.jpg") == 1
