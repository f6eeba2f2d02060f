"""The main figures at the top of the page, with the summary above them and the notices."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stages.analysis.page.figures import MISSING, write_figure
from stages.analysis.page.found import Found
from stages.analysis.page.material import Material
from stages.analysis.page.placed import Placed
from stages.analysis.page.tables import Column, mean_of, rows_about
from stages.scene.remarks import CHOOSE_ANOTHER, HARDLY_SEEN, told_of_cropping, told_of_unread, why_not_placed

OTHERS_OF_YOURS = (
    "Another container that you made from the same splats, such as one with a grain, would look the same: if you "
    "published several, compare it with the files of each."
)
"""A hint for owners: compared with the wrong one of several containers, the message seems to be destroyed."""


@dataclass(frozen=True)
class Tile:
    """A main figure: its label, its value with the unit, and a note, such as a figure to compare it with."""

    label: str
    value: str
    note: str


def owner_summary(material: Material) -> str:
    """A summary with the means over the test views; if nothing was measured, of what is shown."""
    if not material.methods:
        return _shown_summary(material)
    messages = material.messages
    count = {0: "No message is", 1: "One message is"}.get(len(messages), f"{len(messages)} messages are")
    figures = [
        f"the cover reaches {_test_psnr(material)}",
        *(f"{name} {_message_psnr(material, name)}" for name in messages),
    ]
    return f"{count} hidden in one Gaussian splatting scene. On test views {', '.join(figures)}."


def _message_psnr(material: Material, message: str) -> str:
    """The message's mean PSNR on test views; for a hidden image, its PSNR in the view that hides it."""
    there = _image_psnr(material, message)
    if math.isnan(there):
        return _test_psnr(material, message)
    return f"{write_figure('psnr', there)} dB in the view that hides it"


def _image_psnr(material: Material, message: str) -> float:
    """The PSNR of a hidden image in the view that hides it; NaN for a hidden scene."""
    rows = rows_about(material.scores, material.methods[0], message)
    views = {row.view for row in rows if row.quantity == "hides_image" and row.value > 0}
    return mean_of([row for row in rows if row.view in views], Column("psnr", "train"))


def _shown_summary(material: Material) -> str:
    """The summary of a container without photos to compare it with."""
    if not any(each.role == "cover" and not each.has_truth for each in material.pictures):
        return "Nothing was measured."
    messages = [each.title for each in material.pictures if each.role == "message"]
    if not messages:
        return "A Gaussian splatting scene as anyone with its files sees it."
    return f"A Gaussian splatting scene, and what your secret reveals in it: {', '.join(messages)}."


def owner_verdict(found: Found) -> str:
    """Whose container was found, and what was done to it, in plain words."""
    again, own = f"{100 * found.found_again:.1f} %", f"{100 * found.matched:.1f} %"
    whose = f"This is your container: it has {again} of the Gaussians you published, and they are {own} of its own."
    if not found.is_yours:
        whose = (
            "This may be your container, a part of it, or one made from the same photos: "
            f"{own} of its Gaussians lie where {again} of those you published lie."
        )
    done = (
        "mirrored" if found.mirrored else "",
        f"turned by {found.degrees:.1f} degrees" if round(found.degrees, 1) else "",
        f"moved by {found.shift:.4g}" if round(found.shift, 3) else "",
        f"scaled by {found.scale:.4g}" if round(found.scale, 3) != 1 else "",
    )
    moved = f"was {', '.join(filter(None, done))}" if any(done) else "lies where you left it"
    if not found.feature_change:
        return f"{whose} It {moved}."
    return f"{whose} It {moved}, and its features were changed. {OTHERS_OF_YOURS}"


def scene_tiles(material: Material, name: str) -> tuple[Tile, ...]:
    """The first method's fidelity beside that of the others, its size and its speed, as far as they were measured."""
    if not material.methods:
        return ()
    rows = rows_about(material.scores, material.methods[0])
    others = ", ".join(f"{method}: {_test_psnr(material, method=method)}" for method in material.methods[1:])
    gaussians = mean_of(rows, Column("gaussians"))
    count = "" if math.isnan(gaussians) else f"{write_figure('gaussians', gaussians)} Gaussians"
    return (
        *_tile(f"{name}, test views", "psnr", mean_of(rows, Column("psnr", "test")), " dB", others),
        *_tile("SSIM, test views", "ssim", mean_of(rows, Column("ssim", "test")), note=_size(material)),
        *_tile("Published size", "container_bytes", mean_of(rows, Column("container_bytes")), " MB", count),
        *_tile("Time per frame", "seconds_per_frame", mean_of(rows, Column("seconds_per_frame")), " ms"),
    )


def _size(material: Material) -> str:
    """The size of the cover's pictures in words; empty if there are none."""
    covers = [each.rendered.shape for each in material.pictures if each.role == "cover"]
    return f"pictures of {covers[0][2]} x {covers[0][1]} pixels" if covers else ""


def message_tiles(material: Material) -> tuple[Tile, ...]:
    """Each message's PSNR over its covered pixels, beside the best single colour; an image's in the view hiding it."""
    tiles: list[Tile] = []
    for message in material.messages:
        tiles += _tile(f"{message}, in its view", "psnr", _image_psnr(material, message), " dB")
        rows = rows_about(material.scores, material.methods[0], message)
        covered = mean_of(rows, Column("psnr_covered", "test"))
        constant = write_figure("psnr_constant", mean_of(rows, Column("psnr_constant", "test")))
        tiles += _tile(f"{message}, covered pixels", "psnr_covered", covered, " dB", f"one colour: {constant} dB")
    return tuple(tiles)


def owner_placed_tiles(material: Material) -> tuple[Tile, ...]:
    """The number of placed photos of each scene, with the name of the stage that made it."""
    return tuple(_placed_tile(f"{placed.stage}, photos placed", placed) for placed in material.placed)


def public_placed_tiles(material: Material) -> tuple[Tile, ...]:
    """The number of placed photos of each scene, without names."""
    return tuple(_placed_tile("Photos placed", placed) for placed in material.placed)


def _placed_tile(label: str, placed: Placed) -> Tile:
    return Tile(
        label, f"{placed.registered} of {placed.total}", f"{placed.left_out} left out" if placed.left_out else ""
    )


def owner_notices(material: Material) -> tuple[str, ...]:
    """What is wrong and what to do about it.

    Notices concern photos that could not be placed or read, or that force all others to be cropped, and messages
    without a legal test view.
    """
    facts = {record.name: record.facts for record in material.lineage}
    return (
        *(
            f"{placed.stage}: {placed.registered} of {placed.total} photos could be placed; what only the others show "
            f"is missing. The log of {placed.stage} names them. {why_not_placed(facts.get(placed.stage, {}))}"
            for placed in material.placed
            if placed.left_out
        ),
        *(
            f"{record.name}: {said} The log of {record.name} names the photos to leave out."
            for record in material.lineage
            if (said := told_of_cropping(record.facts))
        ),
        *(f"{record.name}: {said}" for record in material.lineage if (said := told_of_unread(record.facts))),
        *(
            f"{message}: {HARDLY_SEEN} {CHOOSE_ANOTHER}"
            for message in material.messages
            if _hardly_seen(material, message)
        ),
    )


def _hardly_seen(material: Material, message: str) -> bool:
    """Whether the message was scored on test views, none of which is legal."""
    flags = [
        row.value
        for row in rows_about(material.scores, material.methods[0], message)
        if row.quantity == "legal" and row.split == "test"
    ]
    return bool(flags) and not any(flags)


def _test_psnr(material: Material, message: str | None = None, method: str | None = None) -> str:
    rows = rows_about(material.scores, method or material.methods[0], message)
    value = mean_of(rows, Column("psnr", "test"))
    return MISSING if math.isnan(value) else f"{write_figure('psnr', value)} dB"


def _tile(label: str, quantity: str, value: float, unit: str = "", note: str = "") -> list[Tile]:
    return [] if math.isnan(value) else [Tile(label, write_figure(quantity, value) + unit, note)]
