"""Videos of a moving camera, as `render_path` and `view_container` make them and the report plays them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, cast

from pipeline.artifact import Artifact, ArtifactWriter
from stages.analysis.comparisons import Role
from stages.scene.attributes import mappings

VideoRole = Role | Literal["side_by_side"]


@dataclass(frozen=True)
class Video:
    """One WebM video of `width` x `height` pixels.

    `panels` are the titles of its panels in reading order, `columns` of them in a row: a single one, or for the role
    `side_by_side` those of all the videos it combines.
    """

    title: str
    role: VideoRole
    method: str
    panels: tuple[str, ...]
    columns: int
    width: int
    height: int
    webm: bytes


def write_videos(writer: ArtifactWriter, videos: Iterable[Video]) -> None:
    """Write a `videos` artifact, in which each video is a file named by its position; it may be empty."""
    described: list[Any] = []
    for position, video in enumerate(videos):
        writer.write_file(_file_name(position), video.webm)
        described.append(
            {
                "title": video.title,
                "role": video.role,
                "method": video.method,
                "panels": list(video.panels),
                "columns": video.columns,
                "size": [video.width, video.height],
            }
        )
    writer.attributes["videos"] = described


def read_videos(artifact: Artifact) -> tuple[Video, ...]:
    """Read a `videos` artifact."""
    return tuple(_read(artifact, position, entry) for position, entry in enumerate(mappings(artifact, "videos")))


def _read(artifact: Artifact, position: int, entry: dict[str, Any]) -> Video:
    width, height = entry["size"]
    return Video(
        title=str(entry["title"]),
        role=cast(VideoRole, entry["role"]),
        method=str(entry["method"]),
        panels=tuple(map(str, entry["panels"])),
        columns=int(entry["columns"]),
        width=int(width),
        height=int(height),
        webm=artifact.file(_file_name(position)).read_bytes(),
    )


def _file_name(position: int) -> str:
    return f"{position}.webm"
