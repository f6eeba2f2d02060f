"""Remarks on containers although nothing failed: messages that no seal protects, and files that were altered.

The engine calls these functions after a result is made, and shows what they return. The stages they are about do not
import them, so that rewording a remark does not redo a stage.
"""

from __future__ import annotations

from pipeline.plain_text import listed
from pipeline.stage import Finished, Remark
from stages.scene.attributes import strings
from stages.scene.plurals import agreeing

CHANNELS_OF_A_PICTURE = 8
"""Those along which our decoders read each picture, the cover and every message."""

IN_THE_OPEN = (
    "This container cannot be sealed, because its scene decoder reads all of its features, or leaves far more of them "
    "than can be encrypted: anyone who knows the method may see the messages without the secret. Ours (homogeneous) "
    "can be sealed with more than eight channels, and best with eight for each picture, the cover's included."
)

MOST_LEFT_OPEN = 0.25
"""Share of the messages (`share_left_open`) that a seal may leave without a remark. Fox, bonsai, kitchen and the
demo's two messages have 0.05 to 0.16 with 16 channels, four messages in the fox 0.50."""

ANOTHER_CONTAINER = (
    "The container is not the one that this secret was exported with: another, or altered since, by a program that "
    "saved it or by someone without the secret. The messages shown may have been altered, too. Fetch the container "
    "from its publisher."
)


def left_open(finished: Finished) -> tuple[Remark, ...]:
    """A remark on `seal`, if messages were to be sealed and are not, or not all of them."""
    was_asked_for = bool(finished.facts.get("seal_wanted"))
    messages = strings(finished.outputs["secret"], "messages")
    if finished.facts.get("sealed"):
        return _partly_open(finished.facts.get("left_open"), len(messages))
    return (Remark(IN_THE_OPEN),) if was_asked_for and messages else ()


def _partly_open(share: object, messages: int) -> tuple[Remark, ...]:
    if not isinstance(share, float) or share <= MOST_LEFT_OPEN:
        return ()
    return (
        Remark(
            f"The seal leaves {share:.0%} of what the messages are made of open, because the scene decoder "
            "reads it, too: a stranger who knows part of a message may recover more of it. The features have too few "
            f"channels for {agreeing(messages, f'{messages} message[s]')}. "
            f"feature_dim: {CHANNELS_OF_A_PICTURE * (1 + messages)} has room for all.",
        ),
    )


def not_as_exported(finished: Finished) -> tuple[Remark, ...]:
    """Remarks on `import_container`, if files are not what the manifest beside them says was exported, or the container
    is not the one that the secret was exported with.
    """
    another = (Remark(ANOTHER_CONTAINER),) if finished.facts.get("another_container") else ()
    recorded = finished.facts.get("altered")
    altered = [str(name) for name in recorded] if isinstance(recorded, list) else []
    if not altered:
        return another
    said = agreeing(
        len(altered),
        "[is|are] not what was exported, as the manifest.json beside [it|them] tells: damaged, or of another container."
        " What is shown may be wrong; fetch the files again.",
    )
    return (Remark(f"{listed(altered)} {said}"), *another)
