"""Which views of a scene may be used for training: at least one."""

from __future__ import annotations

from pipeline.errors import UserError
from stages.scene.scene import Scene


def learnt_names(scene: Scene) -> tuple[str, ...]:
    """The names of the training views. Raises `UserError` if all views are test views."""
    if not scene.train_names:
        raise UserError(
            "the scene has no training view",
            found=f"{len(scene.cameras)} views, all of them test views",
            expected="at least one view that is not held out",
            remedy="give a scene of more views, or one that holds out fewer of them",
        )
    return scene.train_names
