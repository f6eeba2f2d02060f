"""The photos of captures from which a codec or decoder learns: all in memory, reduced so that they fit."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from pipeline.artifact import Artifact
from stages.imaging.pictures import Picture, read_picture
from stages.imaging.shipped_photos import LONGEST_SIDE, no_larger, read_photo
from stages.scene.capture import picture_path, read_capture
from stages.scene.scene import TEST_VIEW_EVERY


def read_photos(capture: Artifact, among: Collection[str] | None = None, longest: int = LONGEST_SIDE) -> list[Picture]:
    """The photos of a capture in its order, or only those `among` these names, with sides of at most `longest`."""
    names = [name for name in read_capture(capture).names if among is None or name in among]
    return [no_larger(read_picture(picture_path(capture, name)), longest) for name in names]


def parted(photos: Sequence[Picture]) -> tuple[list[Picture], list[Picture]]:
    """Split a capture's photos into those to learn from, and every eighth, from the first on, to be held out.

    Nothing is left to learn from a single photo.
    """
    return [photo for row, photo in enumerate(photos) if row % TEST_VIEW_EVERY], [*photos[::TEST_VIEW_EVERY]]


def learnt_photos(
    captures: Sequence[Artifact], shipped: Sequence[str], log: Callable[[str], None], longest: int = LONGEST_SIDE
) -> list[list[Picture]]:
    """The captures' photos without the held-out ones, and the photos of these names that packages ship.

    One list per scene, never an empty one: a capture is a scene, and so is a shipped photo. Captures that leave nothing
    to learn from are left out, and `log` is told.
    """
    scenes = [parted(read_photos(capture, longest=longest))[0] for capture in captures]
    for number, learnt in enumerate(scenes, start=1):
        if not learnt:
            log(f"capture {number} of the photos has no photo but one that is held out: nothing is learnt from it")
    return [learnt for learnt in scenes if learnt] + [[read_photo(name, longest)] for name in shipped]
