"""Reading, resizing and encoding pictures: always uint8 sRGB ``[height, width, 3]``."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.TiffImagePlugin import TiffImageFile
from torch import Tensor

from pipeline.errors import UserError
from stages.imaging.orientation import upright

Picture = UInt8[np.ndarray, "_height _width 3"]
"""Of any size: the underscores keep a call from binding one size to all its pictures."""

# The exceptions that Pillow raises for damaged files have no common base class: its PNG reader even uses SyntaxError.
_UNREADABLE = (
    *(OSError, SyntaxError, ValueError, TypeError, AttributeError, EOFError, RuntimeError, struct.error),
    *(MemoryError, Image.DecompressionBombError),
)

HEIF = (b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1", b"avif", b"avis")
"""Brands (ISO 14496-12) of HEIF and AVIF files."""

FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF", "GIF")
"""The only formats that Pillow may try, whatever the suffix: its EPS reader runs Ghostscript. JPEG includes MPO."""
MOST_PIXELS = 210_000_000
"""Phones take photos of up to 200 million pixels (16320 x 12240). Reading takes 14 to 18 bytes per pixel, or 3 to 4 GB
for such a photo, and a PNG file of a few bytes can claim any number of pixels."""
Image.MAX_IMAGE_PIXELS = MOST_PIXELS  # else Pillow would warn at 89 million and fail at 179 million


def open_picture(path: Path) -> Image.Image:
    """The picture in a file, not decoded yet; raises what `read_picture` turns into `UserError`.

    Raises `ValueError` for more than `MOST_PIXELS`, before any memory is allocated for them.
    """
    image = Image.open(path, formats=FORMATS)
    image.filename = ""  # else Pillow 13 maps the file, with a wrong row length for TIFFs with EXIF quarter turns
    if image.width * image.height > MOST_PIXELS:
        image.close()
        raise ValueError(f"{image.width} x {image.height} pixels, of which at most {MOST_PIXELS:,} are read")
    return image


def read_picture(path: Path) -> Picture:
    """The picture in a file, turned upright by its EXIF orientation; the first frame of an animation.

    Transparent pictures are composited over white; grey, palette, CMYK and 16-bit pictures become 8-bit RGB. Colour
    profiles are ignored: values are taken as sRGB. Raises ``UserError`` naming the file if it is unreadable or cut off.
    """
    try:
        with open_picture(path) as image:
            _refuse_missing_strips(image)
            image.load()
            return _to_rgb(upright(image))
    except _UNREADABLE as error:
        raise UserError(
            "a picture cannot be read",
            where=str(path),
            found=_what_it_is(path, error),
            expected=f"a complete picture ({', '.join(FORMATS)}) of at most {MOST_PIXELS:,} pixels",
            remedy="Name one picture in it."
            if path.is_dir()
            else "Convert it to JPEG if it is a phone's HEIC, whatever it is called; save it smaller if it is too "
            "large; or replace it, or, if it is one of many, take it out of their folder.",
        ) from error


def _what_it_is(path: Path, error: BaseException) -> str:
    """What is wrong with an unreadable file, without its name, which Pillow's message repeats."""
    if path.is_dir():
        return "a folder"
    if not isinstance(error, UnidentifiedImageError):
        return str(error) or type(error).__name__
    with path.open("rb") as file:
        head = file.read(12)
    if head[4:8] == b"ftyp":  # ISO 14496-12: followed by the brand, in four letters
        return f"{'HEIC or AVIF' if head[8:12] in HEIF else 'a video or a raw photo'}, whatever the file is called"
    return "an empty file" if not head else "none of these formats"


def _refuse_missing_strips(image: Image.Image) -> None:
    """Raise `ValueError` for a TIFF file that lacks strips or tiles, which Pillow would leave black."""
    if isinstance(image, TiffImageFile):
        places = np.array([place for _, place, *_ in image.tile]).reshape(-1, 4)  # left, upper, right, lower
        listed = int(np.prod(places[:, 2:] - places[:, :2], axis=1).sum())
        if listed < image.width * image.height:
            raise ValueError(f"{listed} of {image.width * image.height} pixels are in the file")


def in_eight_bits(image: Image.Image) -> Image.Image:
    """Convert 16-bit grey to 8 bits, with alpha if the file declares one grey transparent; return others unchanged.

    Pillow itself reduces 16-bit colours, but clips greys at 255 and does not reduce the colour that the file declares
    transparent; this reduces it in place. The image must be loaded.
    """
    transparent = image.info.get("transparency")
    if image.mode == "RGB" and isinstance(transparent, tuple) and max(transparent) > 255:
        image.info["transparency"] = tuple(value >> 8 for value in transparent)
    if not image.mode.startswith("I"):
        return image
    values = np.asarray(image).clip(0, 65535)
    grey = (values / 257).round().astype(np.uint8)
    if transparent is None:
        return Image.fromarray(grey)
    return Image.fromarray(np.stack([grey, np.where(values == transparent, 0, 255).astype(np.uint8)], axis=-1))


def _to_rgb(image: Image.Image) -> Picture:
    if image.mode == "F":
        raise ValueError("floating-point pictures have no defined range")
    image = in_eight_bits(image)
    if image.has_transparency_data:
        image = image.convert("RGBA")
        image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
    return np.array(image.convert("RGB"))


def resize_picture(picture: Picture, width: int, height: int) -> Picture:
    """The picture at another size: averaged over each new pixel's area if neither side grows, otherwise bicubic.

    Pixel centres are at +0.5, so intrinsics scale by ``width / old width`` and ``height / old height``.
    Raises ``ValueError`` if a side is below one pixel.
    """
    if width < 1 or height < 1:
        raise ValueError(f"a picture cannot be resized to {width} x {height} pixels")
    if (height, width) == picture.shape[:2]:
        return picture.copy()
    shrinks = width <= picture.shape[1] and height <= picture.shape[0]
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(picture, (width, height), interpolation=interpolation))


def encode_png(picture: Picture) -> bytes:
    """The picture as a PNG file, lossless; the same bytes for the same picture.

    For photos, compression level 4 takes 3 % more bytes and a seventh of the time of the highest level.
    """
    return _encode(picture, "PNG", compress_level=4)


def encode_jpeg(picture: Picture, quality: int) -> bytes:
    """The picture as a JPEG file of the given quality (1 to 95), with chroma at full resolution (4:4:4)."""
    return _encode(picture, "JPEG", quality=quality, subsampling=0, optimize=True)


def through_jpeg(picture: Picture, quality: int, full_color: bool = False) -> Picture:
    """The picture after saving as JPEG of the given quality (1 to 95) and reading again.

    Chroma has half resolution in both directions (4:2:0), as most programs save it, or full resolution (4:4:4).
    """
    file = _encode(picture, "JPEG", quality=quality, subsampling=0 if full_color else 2)
    with Image.open(io.BytesIO(file)) as saved:
        return np.array(saved)


def _encode(picture: Picture, file_format: str, **options: int | bool) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, file_format, **options)
    return buffer.getvalue()


def picture_to_tensor(picture: NDArray[np.uint8], device: torch.device | str = "cpu") -> Float[Tensor, "*shape"]:
    """Bytes 0 to 255 as float32 in [0, 1], of the same shape (one picture or several)."""
    return torch.from_numpy(np.array(picture)).to(device).float() / 255


def tensor_to_picture(values: Float[Tensor, "*shape"]) -> NDArray[np.uint8]:
    """Values clamped to [0, 1] and rounded to bytes 0 to 255, of the same shape."""
    scaled = (values.detach().clamp(0, 1) * 255).round()
    return scaled.to(torch.uint8).cpu().numpy()
