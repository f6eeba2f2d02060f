"""What a container hides, which only its secret reveals: some of the given messages, or an image in one view.

Errors do not name messages or images, since they are printed and logged.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from stages.hiding.image_view import IMAGE_VIEW
from stages.scene.attributes import string, strings
from stages.scene.message_views import MessagePictures
from stages.scene.scene import Scene

Views = TypeVar("Views", bound=MessagePictures)


def hidden_messages(given: Mapping[str, Views], secret: Artifact | None) -> dict[str, Views]:
    """The given messages that the container hides; a workflow may give others, too. Empty without a secret."""
    hidden = strings(secret, "messages") if secret is not None else ()
    return {name: views for name, views in given.items() if name in hidden}


def messages_to_read(given: Mapping[str, Views], secret: Artifact | None, stage: str) -> dict[str, Views]:
    """`hidden_messages` for `stage`, which can do without any, if the container hides none.

    Raises `UserError` if messages are given without a secret, or with one of hidden scenes that names none of them:
    otherwise the stage would do its work as if nothing were hidden.
    """
    if given and secret is None:
        raise UserError(
            "the messages cannot be read without the secret",
            found="messages, but no secret",
            expected="the secret, which holds the message decoder",
            remedy=f"give {stage} the input secret: hide.secret",
        )
    if given and secret is not None and strings(secret, "messages") and IMAGE_VIEW not in secret.attributes:
        return at_least_one_hidden(given, secret, stage)
    return hidden_messages(given, secret)


def at_least_one_hidden(given: Mapping[str, Views], secret: Artifact, stage: str) -> dict[str, Views]:
    """`hidden_messages` for `stage`, which needs at least one. Raises `UserError` if there is none."""
    hidden = hidden_messages(given, secret)
    if not hidden:
        names = strings(secret, "messages")
        raise UserError(
            "the container hides none of the messages",
            where=str(secret.path),
            found=f"a secret of {len(names)} others" if names else "a secret of no message",
            expected=f"one of the {len(given)} that were given",
            remedy=f"give {stage} the container and the secret of one training, and its messages",
        )
    return hidden


def view_that_hides(name: str, secret: Artifact | None, scene: Scene, stage: str) -> str:
    """The view of the scene that hides the image of this name; `stage` was given both.

    Raises `UserError` without a secret, for a secret of hidden scenes or of another image, and if the scene does not
    have the view.
    """
    if secret is None or IMAGE_VIEW not in secret.attributes:
        raise UserError(
            "nothing says which view hides the image",
            found="no secret" if secret is None else "the secret of hidden scenes",
            expected="the secret of hide_image",
            remedy=f"give {stage} the input secret: hide.secret",
        )
    if name not in strings(secret, "messages"):
        raise UserError(
            "this is not the image that is hidden",
            found="an image of another name",
            remedy=f"give {stage} the secret and the image of one hide_image",
        )
    return _view_of_the_cover(secret, scene, stage)


def view_of_an_image(secret: Artifact | None, scene: Scene, stage: str) -> str | None:
    """The view of the scene that hides an image; None without a secret, and for one of hidden scenes.

    Raises `UserError` if the scene does not have the view. `stage` is named in the error.
    """
    if secret is None or IMAGE_VIEW not in secret.attributes:
        return None
    return _view_of_the_cover(secret, scene, stage)


def _view_of_the_cover(secret: Artifact, scene: Scene, stage: str) -> str:
    view = string(secret, IMAGE_VIEW)
    if view not in scene.cameras.names:
        raise UserError(
            "the view that hides the image is not in this cover",
            found=f"{len(scene.cameras)} other views",
            remedy=f"give {stage} the cover and the secret of one hide_image",
        )
    return view
