"""What to say of captures and scenes though nothing failed: photos that were left out, messages that are hardly seen.

The engine calls these when a result was made, and shows what they say. The stages that they are about do not import
them: better words make no result of theirs again.
"""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.artifact import Artifact
from pipeline.stage import Finished, Remark
from stages.scene.attributes import strings
from stages.scene.message_views import LEGAL_COVERAGE

HARDLY_SEEN = (
    f"The message fills less than {100 * LEGAL_COVERAGE:.0f} % of every test view: none counts as legal, and its "
    "figures say little."
)
CHOOSE_ANOTHER = "Choose one that was photographed from all the sides from which the cover's cameras look."
OVERLAP = "More overlap between photos, or a larger matching_size, places more."


def photos_left_out(finished: Finished) -> tuple[Remark, ...]:
    """Of `photos`: poses came with some of the photos only; or some lie in another place than most."""
    kept, left, elsewhere = (int(str(finished.facts.get(fact, 0))) for fact in ("photos", "without_pose", "left_out"))
    remarks = []
    if left:
        remarks.append(Remark(f"{kept} of {kept + left} photos came with a pose; the others are left out."))
    if elsewhere:
        remarks.append(
            Remark(
                f"{elsewhere} more photos were left out, which lie in the folder itself or in one for photos in it, "
                "where fewer are; the log says where."
            )
        )
    return tuple(remarks)


def photos_not_placed(finished: Finished) -> tuple[Remark, ...]:
    """Of `sfm`: how many photos of the capture are in the scene, where not all are; the details name the others."""
    names, placed = strings(finished.input("capture"), "names"), strings(finished.outputs["scene"], "names")
    missing = sorted(set(names) - set(placed))
    if not missing:
        return ()
    return (
        Remark(
            f"{len(placed)} of {len(names)} photos placed; the log names the others. {OVERLAP}",
            f"Not placed: {', '.join(missing)}",
        ),
    )


def message_hardly_seen(finished: Finished) -> tuple[Remark, ...]:
    """Of `render_hidden`: no test view of the cover is legal."""
    test_names, views = strings(finished.input("cover"), "test_names"), finished.outputs["views"]
    if not test_names or legal_names(views) & set(test_names):
        return ()
    return (Remark(f"{HARDLY_SEEN} {CHOOSE_ANOTHER}"),)


def legal_names(views: Artifact) -> set[str]:
    """The legal views of a message."""
    legal = views.attributes["legal"]
    flags: Sequence[object] = legal if isinstance(legal, list) else ()
    return {name for name, flag in zip(strings(views, "names"), flags, strict=True) if flag}
