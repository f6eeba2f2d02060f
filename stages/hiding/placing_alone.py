"""Placing splats that come without photos: only the Gaussians themselves can tell from where to look at them."""

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
"""Which way is up in the splats' world. auto: -y, as in most trainings, or the axis that is up in the cover."""

DISTANCES = (2.4, 1.7, 1.2, 0.85)  # from the cover's cameras to the middle of the message, in its radii, farthest first
TILTS = (0.0, 20.0, 40.0)  # degrees by which the cameras look down more steeply on the message than on the cover
TURNS = 8  # about the up axis
AXIS_TOLERANCE = 20.0  # degrees; a cover's up that is not an axis of its world is an accident, not a convention
CLEAR_RADII = 0.5
"""In radii of the message. Surfaces closer than this are fog: a camera that sees them stands among the message's
objects."""
BLURRED = 0.2
"""Gaussians whose standard deviation exceeds this share of a picture's width are fog, too: a scene's back or
outskirts."""


def place_alone(
    gaussians: Gaussians, cover: Scene, up: Up, search_width: int, progress: Callable[[int, int], None]
) -> Similarity:
    """The similarity from the splats' world to the cover's that shows the cover's cameras as much of them as possible.

    It moves the middle of what is visible to where the cover's cameras look, at several distances, tilts and turns.
    These are scored as in `place`, on a sample of views; among equals, the usual up wins, then the farthest and then
    the least tilted.
    """
    rig = rig_of(cover.cameras, cover.points)
    middle, radius = middle_and_radius(gaussians)
    tried = list(product(ups(up, rig.up), DISTANCES, TILTS, range(TURNS)))
    few = cover.cameras.select([cover.cameras.names[row] for row in sample(len(cover.cameras), SAMPLED_VIEWS)])

    def placed(upwards: Float[np.ndarray, " 3"], distance: float, tilt: float, turn: int) -> Similarity:
        alone = Rig(middle, upwards, perpendicular_to(upwards), 0.0, distance * radius, rig.half_extent)
        scale = rig.distance / alone.distance
        return placement(rig, alone, scale, -float(np.radians(tilt)), 2 * np.pi * turn / TURNS)

    def score(similarity: Similarity) -> tuple[int, float]:
        seen = cameras_in_message_world(few, similarity)
        return coverage_score(sharp_coverage(gaussians, seen, search_width, CLEAR_RADII * radius))

    return best([placed(*each) for each in tried], score, progress)


def sharp_coverage(gaussians: Gaussians, cameras: Cameras, width: int, clear_from: float) -> Float32[np.ndarray, " V"]:
    """The share of each picture filled by small enough Gaussians at depth `clear_from` or beyond, in world units.

    Other Gaussians occlude those behind them and do not count. Photos would tell which sides of the message were seen;
    trainings know little of the other sides and fill them with few, large Gaussians. Computed on pictures `width`
    pixels wide.
    """
    largest = gaussians.scales.max(dim=1).values

    def sharp(camera: Camera, depths: Float[Tensor, " N"]) -> Bool[Tensor, " N"]:
        small = largest * camera.intrinsics[0, 0] <= BLURRED * camera.width * depths
        return small & (depths >= clear_from)

    return coverage(gaussians, cameras, width, sharp)


def ups(up: Up, of_cover: Float[np.ndarray, " 3"]) -> list[Float[np.ndarray, " 3"]]:
    """Directions that may be up in the splats' world, the likeliest first; `of_cover` is up in the cover's world."""
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
    """The middle of what is visible of N > 0 Gaussians, and the radius around it that holds half of that.

    Both are medians weighted by opacity times width, so that neither stray Gaussians nor a far background move them.
    """
    means = gaussians.means.detach().cpu().numpy().astype(np.float64)
    weights = visibility(gaussians).astype(np.float64)
    middle = np.array([weighted_median(column, weights) for column in means.T])
    radius = weighted_median(np.linalg.norm(means - middle, axis=1), weights)
    return middle, max(radius, float(gaussians.scales.detach().median()), 1e-12)


def visibility(gaussians: Gaussians) -> Float[np.ndarray, " N"]:
    """How visible each of N Gaussians is: opacity times the geometric mean of its two larger standard deviations."""
    width = gaussians.scales.sort(dim=1).values[:, 1:].prod(dim=1).sqrt()
    return (gaussians.opacities * width).detach().cpu().numpy().clip(np.finfo(np.float32).tiny)


def weighted_median(values: Float[np.ndarray, " N"], weights: Float[np.ndarray, " N"]) -> float:
    """The value at which the cumulative weight reaches half; N > 0, weights must not be negative."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])
