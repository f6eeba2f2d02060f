"""Videos embedded in the page; several panels play in step without a script, since they are one video."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

from stages.analysis.videos import Video


@dataclass(frozen=True)
class Film:
    """A video with a caption under each of its panels, `columns` of them in a row."""

    video: Video
    captions: tuple[str, ...]

    @property
    def columns(self) -> int:
        """How many panels stand in a row."""
        return self.video.columns

    @property
    def data_uri(self) -> str:
        """The video as a data URI."""
        return f"data:video/webm;base64,{base64.b64encode(self.video.webm).decode()}"


def owner_films(videos: Sequence[Video]) -> tuple[Film, ...]:
    """Each method's side-by-side video, or its single videos if it has none; captions name methods if several do."""
    together = {video.method for video in videos if video.role == "side_by_side"}
    chosen = [video for video in videos if video.role == "side_by_side" or video.method not in together]
    several = len({video.method for video in chosen}) > 1
    return tuple(
        Film(video, tuple(f"{title} · {video.method}" if several else title for title in video.panels))
        for video in chosen
    )


def public_films(videos: Sequence[Video]) -> tuple[Film, ...]:
    """Each scene, captioned with its method's name, since the panels' titles would reveal that there are others."""
    return tuple(Film(video, (video.method,)) for video in videos)
