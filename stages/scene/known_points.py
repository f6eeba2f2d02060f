"""Points that came with the poses of photos, as structure from motion found them elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from pipeline.artifact import Artifact, ArtifactWriter

POINTS, COLORS, SEEN, ERROR = "points", "point_colors", "points_seen", "points_error"
"""Arrays of a capture that has points, and an attribute."""


@dataclass(frozen=True)
class KnownPoints:
    """P points that came with V photos, in the order in which they came, in the world of the photos' poses.

    `seen`: how many of them each photo sees. `error`: how far from where they are seen they are projected on average,
    in pixels of the photos that they were made from; None where nothing says so.
    """

    positions: Float64[np.ndarray, "P 3"]
    colors: UInt8[np.ndarray, "P 3"]
    seen: Int64[np.ndarray, " V"]
    error: float | None


def write_points(writer: ArtifactWriter, points: KnownPoints) -> None:
    """Write them beside the poses of a capture."""
    writer.write(POINTS, points.positions)
    writer.write(COLORS, points.colors)
    writer.write(SEEN, points.seen)
    writer.attributes[ERROR] = points.error


def read_points(artifact: Artifact) -> KnownPoints | None:
    """Read what `write_points` wrote; None of a capture without points."""
    if POINTS not in artifact.names:
        return None
    error = artifact.attributes.get(ERROR)
    return KnownPoints(
        artifact.read(POINTS),
        artifact.read(COLORS),
        artifact.read(SEEN),
        float(error) if isinstance(error, float | int) else None,
    )
