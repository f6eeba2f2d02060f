"""Remarks on captures and scenes although nothing failed: photos left out, messages that are hardly seen.

The engine calls these functions after a result is made, and shows what they return. The stages they are about do not
import them, so that rewording a remark does not redo a stage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pipeline.artifact import Artifact
from pipeline.stage import Finished, Remark
from stages.scene.attributes import strings
from stages.scene.message_views import LEGAL_COVERAGE
from stages.scene.plurals import agreeing, counted

Facts = Mapping[str, object]
"""What a stage recorded."""

HARDLY_SEEN = (
    f"The message fills less than {100 * LEGAL_COVERAGE:.0f} % of every test view, so none counts as legal and its "
    "figures mean little."
)
TRAIN_LONGER = "It is in the cover's own place, so its splats may have been trained for too few iterations."
COVER_ITSELF = (
    "The message is the cover itself: both are of the same photos. If that is a slip, stop the run; to hide the cover "
    "in other colours or without an object, use hide_edits."
)
CHOOSE_ANOTHER = "Choose a message photographed from every side from which the cover's cameras look."
WORTH_A_WORD = 0.8
"""If the pictures show at least this fraction of most photos, no remark is made."""
UNSURE_SHARE = 0.2
RIG = "Photos in several folders, such as those of a rig, are used only if no photo lies beside the folders."
OVERLAP = (
    "To place more, take photos with more overlap, or set a larger matching_size, or matching: exhaustive if they were "
    "not taken along one path."
)


def photos_left_out(finished: Finished) -> tuple[Remark, ...]:
    """Remarks on `photos`: pictures and poses that were left out, and why, and masks that are not used."""
    facts = finished.facts
    unread = told_of_unread(facts)
    return (
        *_own_photos(facts),
        *_not_looked_at(facts),
        *_unreadable(facts),
        *_without_pose(facts),
        *_poses_without_photo(facts),
        *_in_other_folders(facts),
        *_copies(facts),
        *_beside_those_used(facts),
        *_masks(facts),
        *([Remark(unread)] if unread else []),
    )


def _number(facts: Facts, fact: str) -> int:
    return int(str(facts.get(fact, 0)))


def _own_photos(facts: Facts) -> tuple[Remark, ...]:
    kept = _number(facts, "photos")
    if not facts.get("own_photos"):
        return ()
    return (Remark(agreeing(kept, f"No pictures given: your own {kept} photo[s] [is|are] used instead.")),)


def _not_looked_at(facts: Facts) -> tuple[Remark, ...]:
    kept, unseen = _number(facts, "photos"), _number(facts, "not_looked_at")
    if not unseen:
        return ()
    return (
        Remark(
            f"{agreeing(kept, f'{kept} picture[s] [is|are] examined')}. "
            f"{agreeing(unseen, f'{unseen} other file[s] in the folder and its subfolders [is|are] not')}: only "
            "pictures directly in the folder and in a readable format count. The log names some."
        ),
    )


def _unreadable(facts: Facts) -> tuple[Remark, ...]:
    kept, broken = _number(facts, "photos"), _recorded(facts, "unreadable")
    if not broken:
        return ()
    return (
        Remark(
            f"{len(broken)} of {counted(kept + len(broken), 'picture')} cannot be read and "
            f"{agreeing(len(broken), '[is left out; the log names it|are left out; the log names them]')}.",
            f"Cannot be read: {', '.join(broken)}",
        ),
    )


def _without_pose(facts: Facts) -> tuple[Remark, ...]:
    kept, left = _number(facts, "photos"), _number(facts, "without_pose")
    if not left:
        return ()
    others = agreeing(left, "the other[s] [is|are] left out")
    return (Remark(f"{kept} of {kept + left} photos came with a pose; {others}."),)


def _poses_without_photo(facts: Facts) -> tuple[Remark, ...]:
    missing = _number(facts, "without_photo")
    if not missing:
        return ()
    poses = agreeing(missing, "pose[s] [was|were] left out because [its photo is|their photos are] missing")
    return (Remark(f"{missing} {poses}; the log names some."),)


def _in_other_folders(facts: Facts) -> tuple[Remark, ...]:
    elsewhere = _number(facts, "left_out")
    if not elsewhere:
        return ()
    photos = f"{elsewhere} more photo[s], in the folder itself or in another of its subfolders,"
    return (Remark(agreeing(elsewhere, f"{photos} [was|were] left out; the log says where.")),)


def _copies(facts: Facts) -> tuple[Remark, ...]:
    kept, copies = _number(facts, "photos"), _number(facts, "copies")
    if not copies:
        return ()
    are = f"{copies} of {kept + copies} photos [is an exact copy of another|are exact copies of others]"
    return (Remark(agreeing(copies, f"{are} and [was|were] left out; the log names [it|them].")),)


def _beside_those_used(facts: Facts) -> tuple[Remark, ...]:
    used, below = _number(facts, "photos") + _number(facts, "without_pose"), _number(facts, "below")
    if not below:
        return ()
    taken = agreeing(used, f"the {used} that [was|were] used")
    beside = agreeing(below, f"{below} photo[s] [lies|lie] in folders beside {taken}, and [was|were] left out.")
    return (Remark(f"{beside} {RIG}" if below > used else f"{beside} The log names the folders."),)


def _masks(facts: Facts) -> tuple[Remark, ...]:
    masked = _number(facts, "masked")
    if not masked:
        return ()
    name = f"{masked} frame[s] [names a mask, which is|name masks, which are] not used"
    return (Remark(agreeing(masked, f"{name}: what [it covers|they cover] is part of the scene.")),)


def told_of_unread(facts: Facts) -> str:
    """A sentence on the pictures that `photos` found but cannot read; empty if there are none."""
    unread = facts.get("unread")
    if not isinstance(unread, dict) or not unread:
        return ""
    suffixes = ", ".join(map(str, unread))
    count = sum(unread.values())
    return agreeing(
        count, f"{count} picture[s] ({suffixes}) cannot be read and [was|were] left out; convert [it|them] to JPEG."
    )


def photos_missing_or_cropped(finished: Finished) -> tuple[Remark, ...]:
    """Remarks on `sfm`: how many photos were placed, poses that may be wrong, and photos that are hardly shown."""
    return (photos_placed(finished), *poses_unsure(finished), *photos_cropped(finished))


def poses_unsure(finished: Finished) -> tuple[Remark, ...]:
    """Remark on `sfm`: how many photos with given poses see hardly a point, if a fifth or more do."""
    recorded, names = finished.facts.get("unsure_poses", []), strings(finished.outputs["scene"], "names")
    unsure = [str(name) for name in recorded] if isinstance(recorded, list) else []
    if len(unsure) < UNSURE_SHARE * len(names) or not unsure:
        return ()
    return (
        Remark(
            agreeing(
                len(unsure),
                f"{len(unsure)} of {counted(len(names), 'photo')} [sees|see] hardly any points that fit "
                "[its given pose: this|their given poses: these] may be wrong, or there is nothing to match. With "
                "poses=estimate the stage estimates its own.",
            ),
            f"These are {', '.join(unsure)}",
        ),
    )


def photos_placed(finished: Finished) -> Remark:
    """Remark on `sfm`: how many photos of the capture are in the scene; the details name the others."""
    names, placed = strings(finished.input("capture"), "names"), strings(finished.outputs["scene"], "names")
    missing = sorted(set(names) - set(placed))
    share = f"{len(placed)} of {counted(len(names), 'photo')} placed"
    if not missing:
        return Remark(share, as_wished=True)
    folded, cropping = (_recorded(finished.facts, why) for why in ("folded", "cropping"))
    details = [
        f"Not placed: {', '.join(missing)}",
        *([f"because of their lenses: {', '.join(folded)}"] if folded else []),
        *([f"taken in the other orientation or zoomed: {', '.join(cropping)}"] if cropping else []),
    ]
    others = agreeing(len(missing), "the other[s]")
    return Remark(f"{share}; the log names {others}. {why_not_placed(finished.facts)}", "; ".join(details))


def why_not_placed(facts: Facts) -> str:
    """What to do about photos that `sfm` did not place, according to what it recorded."""
    folded, cropping = (len(_recorded(facts, why)) for why in ("folded", "cropping"))
    said = []
    if folded:
        said.append(
            agreeing(folded, f"{folded} of them [fits|fit] no real lens, and [was|were] left out: ")
            + "panoramas and crops do not belong in such a folder."
        )
    if cropping:
        said.append(
            agreeing(
                cropping,
                f"{cropping} of them [was|were] taken in the other orientation (portrait or landscape) or zoomed, and "
                "[was|were] left out: all others would have been cropped to what [it shows|they show].",
            )
        )
    return " ".join(said) or OVERLAP


def _recorded(facts: Facts, why: str) -> list[str]:
    recorded = facts.get(why, [])
    return [str(name) for name in recorded] if isinstance(recorded, list) else []


def photos_cropped(finished: Finished) -> tuple[Remark, ...]:
    """Remark on `sfm`: how much the pictures show of most photos, if that is little; the details name those at fault.

    All pictures show what every photo's lens sees: one photo upright among wide ones, or zoomed, crops all others.
    """
    said = told_of_cropping(finished.facts)
    if not said:
        return ()
    names, shares = strings(finished.outputs["scene"], "names"), _shares_shown(finished.facts)
    narrowest = [name for name, share in zip(names, shares, strict=True) if share >= WORTH_A_WORD * max(shares)]
    return (
        Remark(
            f"{said} The log names {len(narrowest)} of {len(names)} "
            + agreeing(
                len(narrowest),
                "that [was|were] taken in the other orientation (portrait or landscape) or zoomed; without [it|them] "
                "the pictures would show more.",
            ),
            f"These show least: {', '.join(narrowest)}",
        ),
    )


def told_of_cropping(facts: Facts) -> str:
    """A sentence on what `sfm` recorded, if pictures show little of most photos; else empty."""
    shares = sorted(_shares_shown(facts))
    most = shares[(len(shares) - 1) // 2] if shares else 1.0
    if most >= WORTH_A_WORD:
        return ""
    return f"The pictures show {100 * most:.0f} % of most photos: all are cropped to what every photo has in view."


def _shares_shown(facts: Facts) -> list[float]:
    """The fraction shown of each photo; empty if all lenses see equally much."""
    recorded = facts.get("shares_shown", [])
    return [float(str(share)) for share in recorded] if isinstance(recorded, list) else []


def message_hardly_seen(finished: Finished) -> tuple[Remark, ...]:
    """Remarks on `render_hidden`: no test view of the cover is legal, and the message is the cover itself."""
    message, cover = finished.inputs.get("message"), finished.input("cover")
    same = (Remark(COVER_ITSELF),) if isinstance(message, Artifact) and _same_scene(message, cover) else ()
    test_names, views = strings(cover, "test_names"), finished.outputs["views"]
    if not test_names or legal_names(views) & set(test_names):
        return same
    is_edited = finished.facts.get("placement") == "same_world"
    return (*same, Remark(f"{HARDLY_SEEN} {TRAIN_LONGER if is_edited or same else CHOOSE_ANOTHER}"))


def _same_scene(one: Artifact, other: Artifact) -> bool:
    """Whether two scenes were made from the same photos: what is private in one may be public in the other.

    Points alone do not tell: converters write the same random ones for any photos. Digests stand for the numbers.
    """
    first, second = one.manifest.arrays, other.manifest.arrays
    if not {"points", "pictures"} <= first.keys() & second.keys() or 0 in first["points"].shape:
        return False
    return all(first[name].sha256 == second[name].sha256 for name in ("points", "pictures"))


def legal_names(views: Artifact) -> set[str]:
    """The names of a message's legal views."""
    legal = views.attributes["legal"]
    flags: Sequence[object] = legal if isinstance(legal, list) else ()
    return {name for name, flag in zip(strings(views, "names"), flags, strict=True) if flag}
