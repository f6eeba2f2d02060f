"""The picture that one camera must see while a cover is learnt (section 4.6)."""

from __future__ import annotations

import torch

from stages.imaging.image import filling
from stages.imaging.pictures import Picture
from stages.scene.cameras import Cameras, single_cameras
from stages.training.objectives import FixedView, PictureTerm


def hidden_image(term: PictureTerm, picture: Picture, cameras: Cameras, view: str) -> FixedView:
    """The picture, scaled to fill that of the camera named `view` and cropped, as what this camera must see.

    Raises `KeyError` for an unknown view, and `UserError` for a picture of which next to nothing would be left.
    """
    camera = single_cameras(cameras.select([view]))[0]
    return FixedView(term, camera, torch.from_numpy(filling(picture, camera.width, camera.height)))
