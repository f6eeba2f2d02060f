"""Points that came with the poses of photos, from structure from motion done elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from pipeline.artifact import Artifact, ArtifactWriter

POINTS, COLORS, SEEN, ERROR = "points", "point_colors", "points_seen", "points_error"
"""Names of a capture's arrays for its points, and of an attribute."""


@dataclass(frozen=True)
class KnownPoints:
    """P points that came with V photos, in the order of their file, in the world of the photos' poses.

    `seen`: how many of them each photo sees. `error`: their mean reprojection error, in pixels of the photos from which
    they were made; None if unknown.
    """

    positions: Float64[np.ndarray, "P 3"]
    colors: UInt8[np.ndarray, "P 3"]
    seen: Int64[np.ndarray, " V"]
    error: float | None


def write_points(writer: ArtifactWriter, points: KnownPoints) -> None:
    """Write the points beside the poses of a capture."""
    writer.write(POINTS, points.positions)
    writer.write(COLORS, points.colors)
    writer.write(SEEN, points.seen)
    writer.attributes[ERROR] = points.error


def read_points(artifact: Artifact) -> KnownPoints | None:
    """Read what `write_points` wrote; None from a capture without points."""
    if POINTS not in artifact.names:
        return None
    error = artifact.attributes.get(ERROR)
    return KnownPoints(
        artifact.read(POINTS),
        artifact.read(COLORS),
        artifact.read(SEEN),
        float(error) if isinstance(error, float | int) else None,
    )
