"""Transparent pictures laid over a colour."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageColor

from stages.imaging.orientation import upright
from stages.imaging.pictures import Picture, in_eight_bits, open_picture


def over_background(path: Path, color: str) -> Picture | None:
    """The picture in a file, upright, over a colour; None where nothing of it is transparent.

    The file is one that `read_picture` can read; `color` is a name or #rrggbb. Transparency is straight, not
    premultiplied, and mixed in sRGB, as the renderings of NeRF's synthetic scenes are by others.
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
