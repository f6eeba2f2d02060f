"""Pictures of a message from the cover's cameras: what a container is trained to hide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError
from stages.scene.attributes import string, strings

LEGAL_COVERAGE = 0.9
"""A view is legal where the message fills at least this share of the picture; the paper names no criterion."""


@dataclass(frozen=True)
class MessageViews:
    """One message seen by V cameras of the cover: pictures over black, and how much of each pixel it fills.

    `points` lie on its surfaces where it was placed, in the cover's world, with their sRGB colours, in an order of
    which any first few are a fair sample.
    """

    name: str
    view_names: tuple[str, ...]
    pictures: UInt8[np.ndarray, "V H W 3"]
    coverage: Float32[np.ndarray, "V H W"]
    points: Float32[np.ndarray, "P 3"]
    point_colors: UInt8[np.ndarray, "P 3"]

    @cached_property
    def mean_coverage(self) -> Float32[np.ndarray, " V"]:
        return self.coverage.mean(axis=(1, 2))

    @cached_property
    def legal(self) -> Bool[np.ndarray, " V"]:
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


def read_messages(artifacts: Sequence[Artifact], cover_names: Sequence[str]) -> dict[str, MessageViews]:
    """Messages by name, each with its views in the order of the cover's names, paired by name and never by position.

    Raises `UserError` where a message lacks a view of the cover, or two messages have one name; it does not say which,
    for errors are printed and logged.
    """
    messages: dict[str, MessageViews] = {}
    for artifact in artifacts:
        name = string(artifact, "message")
        if name in messages:
            raise UserError(
                "two messages have the same name",
                where=str(artifact.path),
                found=f"the name of message {list(messages).index(name) + 1} of {len(artifacts)} again",
                remedy="give each render_hidden a name of its own",
            )
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
        rows = [index[view] for view in cover_names]
        messages[name] = MessageViews(
            name,
            tuple(cover_names),
            artifact.read("pictures")[rows],
            artifact.read("coverage")[rows],
            artifact.read("points"),
            artifact.read("point_colors"),
        )
    return messages
