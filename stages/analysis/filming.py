"""Encoding of filmed pictures as videos: one for each title, and one of all side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from pipeline.errors import UserError
from stages.analysis.videos import Video, VideoRole
from stages.hiding.message_names import FEATURE_MAP, SIDE_BY_SIDE
from stages.hiding.rendering import COVER
from stages.imaging.panels import columns_of, side_by_side
from stages.imaging.pictures import Picture
from stages.imaging.video import doubled, encode_video

MOST_BYTES = 4 * 2**30
"""Largest sum of all pictures. They are held until they are encoded, which takes up to twice as many bytes again."""


def film(moments: Iterable[Mapping[str, Picture]], frames: int, remedy: str) -> dict[str, list[Picture]]:
    """The pictures of every title, one of each of the `frames` moments.

    Raises `UserError`, with `remedy`, at the first moment if all pictures will be more than `MOST_BYTES`. The number of
    titles comes from a secret, which may be a stranger's: a file of a few kilobytes can name a thousand.
    """
    filmed: dict[str, list[Picture]] = {}
    for pictures in moments:
        if not filmed:
            _refuse_too_much({title: doubled(picture) for title, picture in pictures.items()}, frames, remedy)
        for title, picture in pictures.items():
            filmed.setdefault(title, []).append(picture)
    return filmed


def _refuse_too_much(pictures: Mapping[str, Picture], frames: int, remedy: str) -> None:
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

    Each title has at least two pictures, all of the same size with even sides; small ones are `doubled`. Empty if
    nothing was filmed.
    """

    def video(title: str, role: VideoRole, panels: Sequence[str], pictures: Sequence[Picture]) -> Video:
        height, width, _ = pictures[0].shape
        webm = encode_video(pictures, pictures_a_second)
        return Video(title, role, method, tuple(panels), columns_of(len(panels)), width, height, webm)

    large = {title: [*map(doubled, pictures)] for title, pictures in filmed.items()}
    videos = []
    for title, pictures in large.items():
        videos.append(video(title, _role_of(title), [title], pictures))
        after_each()
    if len(large) > 1:
        together = [side_by_side(pictures) for pictures in zip(*large.values(), strict=True)]
        videos.append(video(SIDE_BY_SIDE, "side_by_side", [*large], together))
    return videos


def _role_of(title: str) -> VideoRole:
    return "cover" if title == COVER else "feature_map" if title == FEATURE_MAP else "message"
