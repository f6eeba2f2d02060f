"""Remarks on containers although nothing failed: messages that no seal protects, and files that were altered.

The engine calls these functions after a result is made, and shows what they return. The stages they are about do not
import them, so that rewording a remark does not redo a stage.
"""

from __future__ import annotations

from pipeline.plain_text import listed
from pipeline.stage import Finished, Remark
from stages.scene.attributes import strings
from stages.scene.plurals import agreeing

IN_THE_OPEN = (
    "This container cannot be sealed, because its scene decoder reads all of its features: anyone who knows the method "
    "may see the messages without the secret. Ours (homogeneous) with more than eight channels can be sealed."
)

ANOTHER_CONTAINER = (
    "The container is not the one that this secret was exported with: another, or altered since, by a program that "
    "saved it or by someone without the secret. The messages shown may have been altered, too. Fetch the container "
    "from its publisher."
)


def left_open(finished: Finished) -> tuple[Remark, ...]:
    """A remark on `seal`, if a seal was wanted for messages and the container has none."""
    was_asked_for = bool(finished.facts.get("seal_wanted"))
    if finished.facts.get("sealed") or not was_asked_for or not strings(finished.outputs["secret"], "messages"):
        return ()
    return (Remark(IN_THE_OPEN),)


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
