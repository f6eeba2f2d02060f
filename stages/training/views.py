"""The views that a training learns from, taken from scenes in the store."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import UInt8

from pipeline.errors import UserError
from stages.hiding.rendering import COVER
from stages.scene.cameras import single_cameras
from stages.scene.learnt_views import learnt_names
from stages.scene.scene import Scene
from stages.training.loop import TrainingViews


def training_views(scene: Scene, messages: Mapping[str, UInt8[np.ndarray, "V H W 3"]] | None = None) -> TrainingViews:
    """The scene's training views; `messages` are pictures of each message from all of the scene's cameras, in order.

    Pictures are not copied, since they may take gigabytes. Raises `UserError` for a scene without training views, and
    for a message in pictures of another size. It does not say which message: errors are printed and logged.
    """
    names = learnt_names(scene)
    for values in (messages or {}).values():
        if values.shape != scene.pictures.shape:
            raise UserError(
                "a message was rendered in pictures of another size than the cover's",
                found=_described(values),
                expected=_described(scene.pictures),
                remedy="Render the message from this very cover.",
            )
    rows = scene.rows(names)
    pictures = {COVER: scene.pictures, **(messages or {})}
    return TrainingViews(
        single_cameras(scene.cameras.select(names)),
        {name: [torch.from_numpy(values[row]) for row in rows] for name, values in pictures.items()},
    )


def _described(pictures: UInt8[np.ndarray, "V H W 3"]) -> str:
    views, height, width, _ = pictures.shape
    return f"{views} of {width} x {height} pixels"
