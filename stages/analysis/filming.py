"""Encoding of filmed pictures as videos: one for each title, and one of all side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from pipeline.errors import UserError
from stages.analysis.videos import Video, VideoRole
from stages.hiding.message_names import FEATURE_MAP, SIDE_BY_SIDE
from stages.hiding.rendering import COVER
from stages.imaging.panels import columns_of, side_by_side
from stages.imaging.pictures import Picture
from stages.imaging.video import encode_video

MOST_BYTES = 4 * 2**30
"""Largest sum of all pictures. They are held until they are encoded, which takes up to twice as many bytes again."""


def refuse_too_much(pictures: Mapping[str, Picture], frames: int, remedy: str) -> None:
    """Raise `UserError`, with `remedy`, if `frames` times the first pictures are more than `MOST_BYTES`.

    The number of titles comes from a secret, which may be a stranger's: a file of a few kilobytes can name a thousand.
    """
    size = frames * sum(picture.nbytes for picture in pictures.values())
    if size > MOST_BYTES:
        height, width, _ = next(iter(pictures.values())).shape
        raise UserError(
            "the videos are too large to be held in memory",
            found=f"{len(pictures)} videos of {frames} frames of {width} x {height} pixels, {size / 2**30:.1f} GiB",
            expected=f"at most {MOST_BYTES / 2**30:.0f} GiB",
            remedy=remedy,
        )


def encoded(
    filmed: Mapping[str, Sequence[Picture]],
    method: str,
    pictures_a_second: float,
    after_each: Callable[[], None] = lambda: None,
) -> list[Video]:
    """A video of each title and, for several titles, one of all side by side, as a page cannot keep videos in step.

    Each title has at least two pictures, all of the same size with even sides. Empty if nothing was filmed.
    """

    def video(title: str, role: VideoRole, panels: Sequence[str], pictures: Sequence[Picture]) -> Video:
        height, width, _ = pictures[0].shape
        webm = encode_video(pictures, pictures_a_second)
        return Video(title, role, method, tuple(panels), columns_of(len(panels)), width, height, webm)

    videos = []
    for title, pictures in filmed.items():
        videos.append(video(title, _role_of(title), [title], pictures))
        after_each()
    if len(filmed) > 1:
        together = [side_by_side(pictures) for pictures in zip(*filmed.values(), strict=True)]
        videos.append(video(SIDE_BY_SIDE, "side_by_side", [*filmed], together))
    return videos


def _role_of(title: str) -> VideoRole:
    return "cover" if title == COVER else "feature_map" if title == FEATURE_MAP else "message"
