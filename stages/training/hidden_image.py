"""An image that a container hides already, as a later training of it holds on to it."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from pipeline.artifact import Artifact
from stages.hiding.what_is_hidden import view_that_hides
from stages.imaging.image import filling, read_image
from stages.scene.cameras import single_cameras
from stages.scene.scene import Scene
from stages.training.objectives import FixedView, PictureTerm


def hidden_image(
    image: Artifact | None, secret: Artifact | None, scene: Scene, weight: float, ssim_weight: float, stage: str
) -> Sequence[FixedView]:
    """The one view of the scene that hides the image, for `stage`, which was given both; none without an image.

    `weight` is λ, `ssim_weight` β. Raises `UserError` where the secret does not say which view that is.
    """
    if image is None:
        return ()
    name, picture = read_image(image)
    view = view_that_hides(name, secret, scene, stage)
    camera = single_cameras(scene.cameras.select([view]))[0]
    truth = torch.from_numpy(filling(picture, camera.width, camera.height))
    return (FixedView(PictureTerm(name, weight, ssim_weight), camera, truth),)
