"""Where an image is hidden, which its secret alone says."""

from __future__ import annotations

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from stages.hiding.storage import IMAGE_VIEW
from stages.scene.attributes import string, strings
from stages.scene.scene import Scene


def view_that_hides(name: str, secret: Artifact | None, scene: Scene, stage: str) -> str:
    """The view of the scene that hides the image of this name, for `stage`, which was given both.

    Raises `UserError` for a secret of hidden scenes or of another image, and where the view is none of the scene's.
    """
    if secret is None or IMAGE_VIEW not in secret.attributes:
        raise UserError(
            "nothing says which view hides the image",
            found="no secret" if secret is None else "the secret of hidden scenes",
            expected="the secret of hide_image",
            remedy=f"give {stage} the input secret: hide.secret",
        )
    view, hidden = string(secret, IMAGE_VIEW), strings(secret, "messages")
    if name not in hidden:
        raise UserError(
            "the image is another than the one that is hidden",
            found=f"an image called {name!r}",
            expected=", ".join(map(repr, hidden)),
            remedy=f"give {stage} the secret and the image of one hide_image",
        )
    if view not in scene.cameras.names:
        raise UserError(
            "the view that hides the image is none of this cover's",
            found=f"{len(scene.cameras)} other views",
            remedy=f"give {stage} the cover and the secret of one hide_image",
        )
    return view
