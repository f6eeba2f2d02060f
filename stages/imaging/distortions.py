"""Distortions of 8-bit pictures in transmission: compression, resizing, cropping, blur, noise and brightness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from stages.imaging.pictures import Picture, resize_picture, through_jpeg

Applied = Callable[[Picture, np.random.Generator], Picture]


@dataclass(frozen=True)
class Distortion:
    """`severity` is in the unit that `WORDING` states for `name`."""

    name: str
    severity: float
    apply: Applied


def jpeg(quality: int, full_color: bool = False) -> Distortion:
    """JPEG compression of this quality (1 to 95), with 4:2:0 chroma or at full resolution (4:4:4)."""
    name = "jpeg_full_color" if full_color else "jpeg"
    return Distortion(name, quality, lambda picture, generator: through_jpeg(picture, quality, full_color))


def resized(scale: float) -> Distortion:
    """Downscaling of both sides by `scale`, then upscaling to the original size."""

    def apply(picture: Picture, generator: np.random.Generator) -> Picture:
        height, width = picture.shape[:2]
        small = resize_picture(picture, max(1, round(width * scale)), max(1, round(height * scale)))
        return resize_picture(small, width, height)

    return Distortion("resize", scale, apply)


def smaller(scale: float) -> Distortion:
    """Downscaling of both sides by `scale`, rounded to even sizes, which decoders need."""

    def apply(picture: Picture, generator: np.random.Generator) -> Picture:
        height, width = _even_sides(picture, scale)
        return resize_picture(picture, width, height)

    return Distortion("smaller", scale, apply)


def cropped(share: float) -> Distortion:
    """A window at a random place, with both sides scaled by `share` and rounded to even sizes."""

    def apply(picture: Picture, generator: np.random.Generator) -> Picture:
        height, width = _even_sides(picture, share)
        top = int(generator.integers(picture.shape[0] - height + 1))
        left = int(generator.integers(picture.shape[1] - width + 1))
        return picture[top : top + height, left : left + width].copy()

    return Distortion("crop", share, apply)


def _even_sides(picture: Picture, share: float) -> tuple[int, int]:
    height, width = (max(2, 2 * round(side * share / 2)) for side in picture.shape[:2])
    return height, width


def blurred(sigma: float) -> Distortion:
    """Gaussian blur with a standard deviation of `sigma` pixels, truncated at four of them."""
    return Distortion(
        "blur",
        sigma,
        lambda picture, generator: to_bytes(gaussian_filter(picture.astype(np.float64), (sigma, sigma, 0))),
    )


def noisy(sigma: float) -> Distortion:
    """Gaussian noise with a standard deviation of `sigma` levels of 255, before rounding and clamping."""
    return Distortion(
        "noise", sigma, lambda picture, generator: to_bytes(picture + generator.normal(0, sigma, picture.shape))
    )


def brightened(factor: float) -> Distortion:
    """All values multiplied by `factor`, then rounded and clamped."""
    return Distortion("brightness", factor, lambda picture, generator: to_bytes(picture * factor))


DISTORTIONS = (
    jpeg(90),
    jpeg(70),
    jpeg(50),
    jpeg(90, full_color=True),
    jpeg(70, full_color=True),
    jpeg(50, full_color=True),
    resized(0.5),
    smaller(0.5),
    cropped(0.75),
    blurred(1.0),
    noisy(2.0),
    noisy(5.0),
    brightened(0.8),
    brightened(1.2),
)
"""The distortions under which detection is measured."""

WORDING = {
    "jpeg": "JPEG (4:2:0), quality",
    "jpeg_full_color": "JPEG with full colours (4:4:4), quality",
    "resize": "reduced and enlarged again, share of the sides",
    "smaller": "smaller, share of the sides",
    "crop": "cropped, share of the sides",
    "blur": "blurred, sigma in pixels",
    "noise": "noise, sigma of 255",
    "brightness": "brightness, factor",
}


def random_distortion(picture: Picture, generator: np.random.Generator) -> Picture:
    """Apply one distortion of random kind and strength, or none; all seven choices are equally likely.

    JPEG of quality 50 to 94 (4:4:4), resizing by 0.5 to 1, cropping to 0.7 to 1, blur of 0.2 to 1 pixel, noise of up to
    5 levels, brightness times 0.8 to 1.2.
    """
    drawn = generator.uniform
    kinds: tuple[Callable[[], Distortion], ...] = (
        lambda: jpeg(int(drawn(50, 95)), full_color=True),
        lambda: resized(drawn(0.5, 1)),
        lambda: cropped(drawn(0.7, 1)),
        lambda: blurred(drawn(0.2, 1)),
        lambda: noisy(drawn(0, 5)),
        lambda: brightened(drawn(0.8, 1.2)),
    )
    chosen = int(generator.integers(len(kinds) + 1))
    return picture if chosen == len(kinds) else kinds[chosen]().apply(picture, generator)


def random_tint(generator: np.random.Generator) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Random gains (0.8 to 1.2) and offsets (-0.1 to 0.1, for values in [0, 1]), one per channel, float32."""
    gains, shifts = generator.uniform(0.8, 1.2, 3), generator.uniform(-0.1, 0.1, 3)
    return gains.astype(np.float32), shifts.astype(np.float32)


def random_recoloring(picture: Picture, generator: np.random.Generator) -> Picture:
    """Half the time, change contrast, brightness and colours at random, up to flat, pale, dark or gaudy pictures.

    Differences from the mean colour are multiplied by 0 to 1.5, and each channel's by a further 0.7 to 1.3. The mean
    moves by up to 0.4 of the full range, and each channel by up to 0.2 more.
    """
    if generator.uniform() < 0.5:
        return picture
    mean = picture.mean(axis=(0, 1))
    gains = generator.uniform(0, 1.5) * generator.uniform(0.7, 1.3, 3)
    shifts = 255 * (generator.uniform(-0.4, 0.4) + generator.uniform(-0.2, 0.2, 3))
    return to_bytes(mean + gains * (picture - mean) + shifts)


def to_bytes(values: Float[np.ndarray, "H W 3"]) -> Picture:
    """Round and clamp to 0..255."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
