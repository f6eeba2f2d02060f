"""Pictures beside their ground truth, if there is any, for display in the report."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

import numpy as np

from pipeline.artifact import Artifact, ArtifactWriter
from stages.analysis.stored_views import StoredViews, Views, of_rows
from stages.scene.attributes import mappings

Role = Literal["cover", "message", "feature_map"]


@dataclass(frozen=True)
class Comparison:
    """K views of one picture, such as a message: `truth` beside `rendered`, uint8 [K, H, W, 3].

    The two are equal for a feature map, and if there is no truth (`has_truth` is False); the latter is stored once.
    """

    title: str
    role: Role
    method: str
    names: tuple[str, ...]
    splits: tuple[str, ...]
    truth: Views
    rendered: Views
    has_truth: bool = True

    def of_views(self, names: Collection[str]) -> Comparison:
        """A copy with only the views in `names`."""
        rows = [row for row, name in enumerate(self.names) if name in names]
        return replace(
            self,
            names=tuple(self.names[row] for row in rows),
            splits=tuple(self.splits[row] for row in rows),
            truth=of_rows(self.truth, rows),
            rendered=of_rows(self.rendered, rows),
        )


def write_comparisons(writer: ArtifactWriter, comparisons: Iterable[Comparison]) -> None:
    """Write a `comparisons` artifact, which may be empty."""
    described: list[Any] = []
    for position, comparison in enumerate(comparisons):
        if comparison.has_truth:
            writer.write(f"{position}/truth", np.asarray(comparison.truth))
        writer.write(f"{position}/rendered", np.asarray(comparison.rendered))
        described.append(
            {
                "title": comparison.title,
                "role": comparison.role,
                "method": comparison.method,
                "names": list(comparison.names),
                "splits": list(comparison.splits),
                "has_truth": comparison.has_truth,
            }
        )
    writer.attributes["comparisons"] = described


def read_comparisons(artifact: Artifact) -> tuple[Comparison, ...]:
    """Read a `comparisons` artifact, whose pictures stay on disk: a page shows a few of all views."""
    return tuple(
        Comparison(
            title=str(entry["title"]),
            role=cast(Role, entry["role"]),
            method=str(entry["method"]),
            names=tuple(cast(list[str], entry["names"])),
            splits=tuple(cast(list[str], entry["splits"])),
            truth=StoredViews(artifact, f"{position}/{'truth' if entry.get('has_truth', True) else 'rendered'}"),
            rendered=StoredViews(artifact, f"{position}/rendered"),
            has_truth=bool(entry.get("has_truth", True)),
        )
        for position, entry in enumerate(mappings(artifact, "comparisons"))
    )
