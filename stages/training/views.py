"""The views that a training learns from, taken from scenes in the store."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import UInt8

from stages.hiding.rendering import COVER
from stages.scene.cameras import single_cameras
from stages.scene.learnt_views import learnt_names
from stages.scene.scene import Scene
from stages.training.loop import TrainingViews


def training_views(scene: Scene, messages: Mapping[str, UInt8[np.ndarray, "V H W 3"]] | None = None) -> TrainingViews:
    """The scene's training views; `messages` are pictures of each message from all of the scene's cameras, in order.

    Pictures are not copied, since they may take gigabytes. Raises `UserError` for a scene without training views.
    """
    names = learnt_names(scene)
    rows = scene.rows(names)
    pictures = {COVER: scene.pictures, **(messages or {})}
    return TrainingViews(
        single_cameras(scene.cameras.select(names)),
        {name: [torch.from_numpy(values[row]) for row in rows] for name, values in pictures.items()},
    )
