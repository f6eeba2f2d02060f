"""Pictures of a message from the cover's cameras: what a container is trained to hide."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError
from stages.scene.attributes import string, strings

LEGAL_COVERAGE = 0.9
"""A view is legal if the message fills at least this fraction of the picture; the paper states no criterion."""


@dataclass(frozen=True)
class MessagePictures:
    """One message seen by V cameras of the cover, over black: all that a training learns from.

    `points` lie on its surfaces as placed in the cover's world, with sRGB colours; any prefix is a fair sample.
    """

    name: str
    view_names: tuple[str, ...]
    pictures: UInt8[np.ndarray, "V H W 3"]
    points: Float32[np.ndarray, "P 3"]
    point_colors: UInt8[np.ndarray, "P 3"]


@dataclass(frozen=True)
class MessageViews(MessagePictures):
    """`MessagePictures` and each pixel's coverage by the message (0 to 1), in more bytes than the pictures."""

    coverage: Float32[np.ndarray, "V H W"]

    @cached_property
    def mean_coverage(self) -> Float32[np.ndarray, " V"]:
        """Mean coverage of each view."""
        return self.coverage.mean(axis=(1, 2))

    @cached_property
    def legal(self) -> Bool[np.ndarray, " V"]:
        """Whether each view's mean coverage is at least `LEGAL_COVERAGE`."""
        return self.mean_coverage >= LEGAL_COVERAGE


def write_message_views(writer: ArtifactWriter, views: MessageViews) -> None:
    """Write a `views` artifact."""
    writer.write("pictures", views.pictures)
    writer.write("coverage", views.coverage)
    writer.write("points", views.points)
    writer.write("point_colors", views.point_colors)
    writer.attributes.update(
        message=views.name,
        names=list(views.view_names),
        legal=[bool(value) for value in views.legal],
        mean_coverage=[round(float(value), 6) for value in views.mean_coverage],
    )


def read_message_pictures(artifacts: Sequence[Artifact], cover_names: Sequence[str]) -> dict[str, MessagePictures]:
    """Messages by name, with their views in the order of the cover's names: paired by name, never by position.

    Raises `UserError` if a message lacks a view of the cover, or two messages share a name. Errors are printed and
    logged, so they do not state the message's name.
    """
    return {
        name: MessagePictures(
            name, tuple(cover_names), _rows(artifact, "pictures", rows), *map(artifact.read, ("points", "point_colors"))
        )
        for name, artifact, rows in _paired(artifacts, cover_names)
    }


def read_messages(artifacts: Sequence[Artifact], cover_names: Sequence[str]) -> dict[str, MessageViews]:
    """Like `read_message_pictures`, with the coverage."""
    messages = read_message_pictures(artifacts, cover_names)
    return {
        name: MessageViews(**vars(messages[name]), coverage=_rows(artifact, "coverage", rows))
        for name, artifact, rows in _paired(artifacts, cover_names)
    }


def _paired(artifacts: Sequence[Artifact], cover_names: Sequence[str]) -> Iterator[tuple[str, Artifact, list[int]]]:
    """Each message's name and artifact, and its rows in the order of the cover's names."""
    found: list[str] = []
    for artifact in artifacts:
        name = string(artifact, "message")
        if name in found:
            raise UserError(
                "two messages have the same name",
                where=str(artifact.path),
                found=f"the name of message {found.index(name) + 1} of {len(artifacts)} again",
                remedy="give each render_hidden a name of its own",
            )
        found.append(name)
        index = {view: row for row, view in enumerate(strings(artifact, "names"))}
        missing = [view for view in cover_names if view not in index]
        if missing:
            raise UserError(
                "a message was not rendered for all of the cover's views",
                where=str(artifact.path),
                found=f"no picture for {', '.join(missing[:3])}",
                expected=f"{len(cover_names)} views with the cover's names",
                remedy="render the message from this very cover",
            )
        yield name, artifact, [index[view] for view in cover_names]


def _rows(artifact: Artifact, name: str, rows: Sequence[int]) -> np.ndarray:
    """These rows of an array, which is not copied if they are all its rows in order."""
    values = artifact.read(name)
    return values if [*rows] == [*range(len(values))] else values[rows]
