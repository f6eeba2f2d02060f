"""Quality of a watermark codec's hidden and recovered pictures, on photos that it was not trained on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import torch

from stages.analysis.measurements import Measurement
from stages.hiding.watermark.codec import WatermarkCodec
from stages.imaging.image import filling
from stages.imaging.pictures import Picture, picture_to_tensor, tensor_to_picture
from stages.imaging.psnr import psnr
from stages.imaging.windows import random_window

WIDTH, HEIGHT = 200, 112
WINDOWS = 16
"""Pictures tested per group of photos: windows of the size that pictures have in the CPU profile."""

MARKED, FOUND = "psnr_watermarked", "psnr_found"
"""PSNR of the watermarked 8-bit picture, and of the watermark decoded from it."""

GIVEN = "the given watermark in "


def quality(
    codec: WatermarkCodec, photos: Mapping[str, Sequence[Picture]], watermarks: Sequence[Picture], seed: int
) -> Iterator[Measurement]:
    """PSNRs for each non-empty group of photos: windows of its photos hidden in others, then the given watermarks."""
    for group, pictures in photos.items():
        if pictures:
            generator = np.random.default_rng(seed)
            windows = [_window(pictures, row, generator) for row in range(2 * WINDOWS)]
            yield from _scores(codec, group, windows[::2], windows[1::2])
            for watermark in watermarks:
                yield from _scores(codec, GIVEN + group, windows[::2], [filling(watermark, WIDTH, HEIGHT)] * WINDOWS)


def _window(pictures: Sequence[Picture], row: int, generator: np.random.Generator) -> Picture:
    return random_window(pictures[row % len(pictures)], WIDTH, HEIGHT, generator)


@torch.no_grad()
def _scores(
    codec: WatermarkCodec, group: str, images: Sequence[Picture], watermarks: Sequence[Picture]
) -> Iterator[Measurement]:
    for row, (image, watermark) in enumerate(zip(images, watermarks, strict=True)):
        cover, hidden = (picture_to_tensor(each, codec.device) for each in (image, watermark))
        marked = picture_to_tensor(tensor_to_picture(codec.encode(cover, hidden)), codec.device)
        found = codec.decode(marked)
        for quantity, picture, truth in ((MARKED, marked, cover), (FOUND, found, hidden)):
            yield Measurement(quantity, psnr(picture, truth), group, view=f"window {row}", split="test")
