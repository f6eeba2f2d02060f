"""The photos of captures as a codec or a decoder learns from them: all in memory, none too large for that."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from pipeline.artifact import Artifact
from stages.imaging.pictures import Picture, read_picture
from stages.imaging.shipped_photos import LONGEST_SIDE, no_larger, read_photo
from stages.scene.capture import picture_path, read_capture
from stages.scene.scene import TEST_VIEW_EVERY


def read_photos(capture: Artifact, among: Collection[str] | None = None, longest: int = LONGEST_SIDE) -> list[Picture]:
    """The photos of a capture, in their order: all, or those of these names; reduced to a side of `longest`."""
    names = [name for name in read_capture(capture).names if among is None or name in among]
    return [no_larger(read_picture(picture_path(capture, name)), longest) for name in names]


def parted(photos: Sequence[Picture]) -> tuple[list[Picture], list[Picture]]:
    """A capture's photos: those to learn from, and every eighth, the first among them, which is held out."""
    return [photo for row, photo in enumerate(photos) if row % TEST_VIEW_EVERY], [*photos[::TEST_VIEW_EVERY]]


def learnt_photos(
    captures: Sequence[Artifact], shipped: Sequence[str], longest: int = LONGEST_SIDE
) -> list[list[Picture]]:
    """The captures' photos but those that are held out, and those that packages ship, by their names.

    A list for each scene: a capture is one, and so is a shipped photo.
    """
    of_captures = [parted(read_photos(capture, longest=longest))[0] for capture in captures]
    return of_captures + [[read_photo(name, longest)] for name in shipped]
