"""Placing splats that come without their photos: where to look at them from, only the Gaussians themselves can tell."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from stages.hiding.placing import coverage, coverage_score
from stages.scene.alignment import (
    SAMPLED_VIEWS,
    Rig,
    best,
    cameras_in_message_world,
    perpendicular_to,
    placement,
    rig_of,
    sample,
)
from stages.scene.cameras import Camera, Cameras
from stages.scene.gaussians import Gaussians
from stages.scene.scene import Scene
from stages.scene.similarity import Similarity

Up = Literal["auto", "-y", "y", "-z", "z", "-x", "x"]
"""Which way is up in the world of the splats; auto: -y, as of most trainings, or the axis that is up in the cover."""

DISTANCES = (2.4, 1.7, 1.2, 0.85)  # of the cover's cameras from the middle of the message, in its radii, farthest first
TILTS = (0.0, 20.0, 40.0)  # degrees by which the cover's cameras look down on the message more than on the cover
TURNS = 8  # about the up axis
AXIS_TOLERANCE = 20.0  # degrees; the up of a cover that is no axis of its world is an accident, no convention
CLEAR_RADII = 0.5
"""Surfaces closer than this are fog: a camera that sees them stands in the midst of the message's things."""
BLURRED = 0.2
"""So are Gaussians whose standard deviation is this share of a picture's width: a scene's back, or its outskirts."""


def place_alone(
    gaussians: Gaussians, cover: Scene, up: Up, search_width: int, progress: Callable[[int, int], None]
) -> Similarity:
    """From the splats' world into the cover's, so that the cover's cameras see as much of them as possible.

    The middle of what is seen comes to lie where the cover's cameras look, at several distances, tilts and turns. They
    are scored as `place` scores, on a sample of views; of equals the farthest and the least tilted is taken.
    """
    rig = rig_of(cover.cameras, cover.points)
    middle, radius = middle_and_radius(gaussians)
    tried = list(product(ups(up, rig.up), DISTANCES, TILTS, range(TURNS)))
    few = cover.cameras.select([cover.cameras.names[row] for row in sample(len(cover.cameras), SAMPLED_VIEWS)])
    scored = 0

    def placed(upwards: Float[np.ndarray, " 3"], distance: float, tilt: float, turn: int) -> Similarity:
        alone = Rig(middle, upwards, perpendicular_to(upwards), 0.0, distance * radius, rig.half_extent)
        scale = rig.distance / alone.distance
        return placement(rig, alone, scale, -float(np.radians(tilt)), 2 * np.pi * turn / TURNS)

    def score(similarity: Similarity) -> tuple[int, float]:
        nonlocal scored
        scored += 1
        progress(scored, len(tried))
        seen = cameras_in_message_world(few, similarity)
        return coverage_score(sharp_coverage(gaussians, seen, search_width, CLEAR_RADII * radius))

    return best([placed(*each) for each in tried], score)


def sharp_coverage(gaussians: Gaussians, cameras: Cameras, width: int, clear_from: float) -> Float32[np.ndarray, " V"]:
    """The share of each picture that small enough Gaussians fill from the depth `clear_from` on, in world units.

    Others hide what is behind them and count nothing. Photos would tell which sides of the message were seen; of the
    others trainings know little, and fill them with few and large Gaussians. Looked at in `width` pixels a row.
    """
    largest = gaussians.scales.max(dim=1).values

    def sharp(camera: Camera, depths: Float[Tensor, " N"]) -> Bool[Tensor, " N"]:
        small = largest * camera.intrinsics[0, 0] <= BLURRED * camera.width * depths
        return small & (depths >= clear_from)

    return coverage(gaussians, cameras, width, sharp)


def ups(up: Up, of_cover: Float[np.ndarray, " 3"]) -> list[Float[np.ndarray, " 3"]]:
    """The directions that may be up in the splats' world, the likeliest first; `of_cover` is up in the cover's."""
    if up != "auto":
        return [direction_of(up)]
    nearest = np.zeros(3)
    axis = int(np.abs(of_cover).argmax())
    nearest[axis] = np.sign(of_cover[axis])
    usual = direction_of("-y")
    conventional = np.degrees(np.arccos(np.clip(nearest @ of_cover, -1, 1))) <= AXIS_TOLERANCE
    return [usual, nearest] if conventional and nearest @ usual < 1 else [usual]


def direction_of(axis: str) -> Float[np.ndarray, " 3"]:
    """The unit vector of an axis such as -y."""
    direction = np.zeros(3)
    direction["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return direction


def middle_and_radius(gaussians: Gaussians) -> tuple[Float[np.ndarray, " 3"], float]:
    """The middle of what is seen of N Gaussians, N > 0, and the radius about it that holds half of that.

    Medians over Gaussians that count by their opacity times width: stray ones and a far background move neither.
    """
    means = gaussians.means.detach().cpu().numpy().astype(np.float64)
    weights = visibility(gaussians).astype(np.float64)
    middle = np.array([weighted_median(column, weights) for column in means.T])
    radius = weighted_median(np.linalg.norm(means - middle, axis=1), weights)
    return middle, max(radius, float(gaussians.scales.detach().median()), 1e-12)


def visibility(gaussians: Gaussians) -> Float[np.ndarray, " N"]:
    """How much is seen of each of N Gaussians: its opacity times the root of its two larger standard deviations."""
    width = gaussians.scales.sort(dim=1).values[:, 1:].prod(dim=1).sqrt()
    return (gaussians.opacities * width).detach().cpu().numpy().clip(np.finfo(np.float32).tiny)


def weighted_median(values: Float[np.ndarray, " N"], weights: Float[np.ndarray, " N"]) -> float:
    """The value below which half of the weight lies; N > 0, and no weight is negative."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])
