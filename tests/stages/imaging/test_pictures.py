from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageOps

from pipeline.errors import UserError
from stages.imaging.pictures import (
    encode_jpeg,
    encode_png,
    picture_to_tensor,
    read_picture,
    resize_picture,
    tensor_to_picture,
)


@pytest.fixture
def gradient() -> np.ndarray:
    """Smooth, so that JPEG hardly changes it, and different in each corner and channel."""
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
