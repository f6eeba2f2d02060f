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

Picture = UInt8[np.ndarray, "height width 3"]

# Pillow has no common ancestor for what a damaged file raises: its PNG reader even uses SyntaxError.
_UNREADABLE = (
    *(OSError, SyntaxError, ValueError, TypeError, AttributeError, EOFError, RuntimeError, struct.error),
    *(MemoryError, Image.DecompressionBombError),
)

HEIF = (b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1", b"avif", b"avis")
"""Brands of files that hold pictures in the manner of HEIF."""

FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF", "GIF")
"""All that Pillow may try, whatever a file is called: its reader of EPS starts Ghostscript. MPO is read as JPEG."""
MOST_PIXELS = 210_000_000
"""Phones take up to 200 million (16320 x 12240). A pixel takes 14 to 18 bytes while it is read, such a photo 3 to 4 GB,
and a few bytes of PNG may claim any number of them."""
Image.MAX_IMAGE_PIXELS = MOST_PIXELS  # Pillow's own limit, 179 million, would come first, and warn of half as many


def open_picture(path: Path) -> Image.Image:
    """The picture in a file, not decoded yet; raises what `read_picture` turns into `UserError`.

    `ValueError` for one of over `MOST_PIXELS`, before there is any room for them.
    """
    image = Image.open(path, formats=FORMATS)
    image.filename = ""  # else Pillow 13 maps the file: TIFFs that EXIF turns by a quarter in rows of a wrong length
    if image.width * image.height > MOST_PIXELS:
        image.close()
        raise ValueError(f"{image.width} x {image.height} pixels, of which at most {MOST_PIXELS:,} are read")
    return image


def read_picture(path: Path) -> Picture:
    """The picture in a file, upright by its EXIF orientation; the first frame of an animation.

    Transparency is laid over white; grey, palette, CMYK and 16-bit pictures become 8-bit RGB. Colour profiles are
    ignored: values count as sRGB. Raises ``UserError`` naming the file if it cannot be read to its last byte.
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
            remedy="Convert it to JPEG if it is a phone's HEIC, whatever it is called; save it smaller if it is too "
            "large; or replace it, or take it out of the folder.",
        ) from error


def _what_it_is(path: Path, error: BaseException) -> str:
    """What is wrong with a file, without its name, which Pillow repeats."""
    if not isinstance(error, UnidentifiedImageError):
        return str(error) or type(error).__name__
    with path.open("rb") as file:
        head = file.read(12)
    if head[4:8] == b"ftyp":  # ISO 14496-12: what kind of file, in four letters
        return f"{'HEIC or AVIF' if head[8:12] in HEIF else 'a video or a raw photo'}, whatever the file is called"
    return "an empty file" if not head else "none of these formats"


def _refuse_missing_strips(image: Image.Image) -> None:
    """Of a TIFF, whose rows lie in strips or tiles: Pillow leaves what its file does not list black."""
    if isinstance(image, TiffImageFile):
        places = np.array([place for _, place, *_ in image.tile]).reshape(-1, 4)  # left, upper, right, lower
        listed = int(np.prod(places[:, 2:] - places[:, :2], axis=1).sum())
        if listed < image.width * image.height:
            raise ValueError(f"{listed} of {image.width * image.height} pixels are in the file")


def in_eight_bits(image: Image.Image) -> Image.Image:
    """16-bit grey in 8 bits, with alpha where the file calls one grey transparent; any other picture as it is.

    Pillow itself reduces 16-bit colours, but cuts greys off at 255, and leaves the colour that the file calls
    transparent as it was. The picture must be loaded.
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
    """The picture at another size: the mean over each new pixel's area when both sides shrink, otherwise bicubic.

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
    """The picture as a PNG file, without loss; the same bytes for the same picture.

    At level 4 photos take 3 % more bytes and a seventh of the time of the highest level.
    """
    return _encode(picture, "PNG", compress_level=4)


def encode_jpeg(picture: Picture, quality: int) -> bytes:
    """The picture as a JPEG file of the given quality (1 to 95), with colours at full resolution."""
    return _encode(picture, "JPEG", quality=quality, subsampling=0, optimize=True)


def through_jpeg(picture: Picture, quality: int, full_color: bool = False) -> Picture:
    """The picture saved as a JPEG file of the given quality (1 to 95), and read again.

    With colours at half resolution each way, as most programs save (4:2:0); or at full (4:4:4).
    """
    file = _encode(picture, "JPEG", quality=quality, subsampling=0 if full_color else 2)
    with Image.open(io.BytesIO(file)) as saved:
        return np.array(saved)


def _encode(picture: Picture, file_format: str, **options: int | bool) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, file_format, **options)
    return buffer.getvalue()


def picture_to_tensor(picture: NDArray[np.uint8], device: torch.device | str = "cpu") -> Float[Tensor, "*shape"]:
    """Bytes 0 to 255 as float32 in [0, 1], of the same shape (one picture or many)."""
    return torch.from_numpy(np.array(picture)).to(device).float() / 255


def tensor_to_picture(values: Float[Tensor, "*shape"]) -> NDArray[np.uint8]:
    """Values, clamped to [0, 1], as the nearest bytes 0 to 255, of the same shape."""
    scaled = (values.detach().clamp(0, 1) * 255).round()
    return scaled.to(torch.uint8).cpu().numpy()
