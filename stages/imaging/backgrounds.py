"""Compositing of transparent pictures over a background colour."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageColor

from stages.imaging.orientation import upright
from stages.imaging.pictures import Picture, in_eight_bits, open_picture


def over_background(path: Path, color: str) -> Picture | None:
    """The picture in a file, upright, composited over a colour; None if every pixel is opaque.

    The file must be readable by `read_picture`; `color` is a name or #rrggbb. Alpha is straight, not premultiplied, and
    blended in sRGB, as is usual for the renderings of NeRF's synthetic scenes.
    """
    with open_picture(path) as image:
        if not image.has_transparency_data:
            return None
        image.load()
        picture = in_eight_bits(upright(image)).convert("RGBA")
    if picture.getchannel("A").getextrema()[0] == 255:
        return None
    background = Image.new("RGBA", picture.size, (*ImageColor.getrgb(color)[:3], 255))
    return np.array(Image.alpha_composite(background, picture).convert("RGB"))
