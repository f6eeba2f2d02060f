"""Placing a message in the cover's world: similarities under which the cover's cameras see the message well.

A rig of cameras is summarised by the point it looks at (focus), its up direction, the side it looks from, its distance
from the focus, and how much it sees there. Each candidate maps the message's focus onto the cover's and, unless it
tilts, up onto up; rotation and scale vary. Only rendering can tell which candidate fills the cover's pictures best, so
the caller scores them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice, product
from typing import Any, Protocol, TypeVar

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from stages.scene.cameras import Cameras
from stages.scene.similarity import Similarity

CANDIDATES = 24  # at most, for the caller to score
AZIMUTHS = 24  # rotations about the up axis to try
ZOOMS = (1.0, 1.2, 1.4, 0.85)  # factors by which each scale is varied
CLOSEST = 0.6  # no candidate brings the cameras closer to the focus than this fraction of the message's own distance
ANGLE_SLACK = 10.0  # degrees by which a tried turn's stray angle may exceed the smallest
PARALLEL_GUARD = 0.01  # weight of the points' median depth relative to the intersection of the optical axes
UPRIGHT_GUARD = 0.005  # weight of the cameras' mean up direction relative to level horizons
GRID = 8  # cells per side, for the quick estimate of coverage
SAMPLED_VIEWS = 12
SAMPLED_POINTS = 2000
NEAREST = 0.02  # quantile of depths that counts as the nearest depth


class Comparable(Protocol):
    """A value with an order, as scores need."""

    def __lt__(self, other: Any, /) -> bool: ...


Score = TypeVar("Score", bound=Comparable)


@dataclass(frozen=True)
class Rig:
    """Where V cameras look, and from where, in world coordinates; `up` and `forward` are perpendicular unit vectors."""

    focus: Float[np.ndarray, " 3"]
    up: Float[np.ndarray, " 3"]
    forward: Float[np.ndarray, " 3"]
    elevation: float  # mean angle below the horizontal of the viewing directions, in radians
    distance: float  # median distance of the cameras from the focus
    half_extent: Float[np.ndarray, " 2"]  # half the width and height visible at the focus

    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Right, down and level forward as columns: OpenCV camera axes with a level horizon."""
        return np.stack([np.cross(self.forward, self.up), -self.up, self.forward], axis=1)


def rig_of(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> Rig:
    """Summarise a rig. `points` (P = 0 is allowed) only help to tell how far nearly parallel optical axes look.

    Raises `ValueError` without cameras.
    """
    if not len(cameras):
        raise ValueError("a rig without cameras cannot be aligned")
    right, down, views = (cameras.world_to_camera[:, row, :3] for row in range(3))
    focus = focus_point(cameras, points)
    up = up_direction(right, down)
    mean_view = views.mean(axis=0)
    level = mean_view - up * (mean_view @ up)
    forward = level if np.linalg.norm(level) > 1e-6 else perpendicular_to(up)
    distance = float(np.median(np.linalg.norm(cameras.centres() - focus, axis=1)))
    size = np.array([cameras.width, cameras.height])
    tangents = np.median(size / 2 / cameras.intrinsics[:, [0, 1], [0, 1]], axis=0)
    downward = float(np.arcsin(np.clip(-(views @ up), -1, 1)).mean())
    return Rig(focus, up, unit(forward), downward, max(distance, 1e-12), max(distance, 1e-12) * tangents)


def focus_point(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " 3"]:
    """The least-squares intersection of all optical axes.

    Nearly parallel axes intersect nowhere or far away, so a small weight pulls the point towards where the axes reach
    the median depth of the points in front of the cameras.
    """
    centres, views = cameras.centres(), cameras.world_to_camera[:, 2, :3]
    across = np.eye(3) - views[:, :, None] * views[:, None, :]
    looked_at = centres + views * median_depth(cameras, points)
    left = across.mean(axis=0) + PARALLEL_GUARD * np.eye(3)
    right = np.einsum("vij,vj->i", across, centres) / len(cameras) + PARALLEL_GUARD * looked_at.mean(axis=0)
    return np.linalg.solve(left, right)


def median_depth(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> float:
    """The median depth of the points inside the cameras' pictures, over all cameras.

    If no camera sees a point: twice the largest distance of a camera from the cameras' mean, or 1 if that is 0.
    """
    depths = depths_seen(cameras, points)
    if len(depths):
        return float(np.median(depths))
    centres = cameras.centres()
    return 2 * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()) or 1.0


def nearest_depth(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> float:
    """Depth of the nearest content in the cameras' pictures: a low quantile of point depths, to exclude outliers.

    0 if no camera sees a point.
    """
    depths = depths_seen(cameras, points)
    return float(np.quantile(depths, NEAREST)) if len(depths) else 0.0


def depths_seen(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " n"]:
    """Depths of the points inside each camera's picture; of many points, only a sample is used."""
    pixels, depth = project(cameras, points[sample(len(points), SAMPLED_POINTS)])
    size = np.array([cameras.width, cameras.height])
    return depth[(depth > 0) & (pixels >= 0).all(axis=-1) & (pixels < size).all(axis=-1)]


def up_direction(right: Float[np.ndarray, "V 3"], down: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " 3"]:
    """The direction that makes the horizons of all pictures most level, on the side of the cameras' own up.

    Photographers hold a camera level: its right axis is perpendicular to gravity, even if it looks down. If all cameras
    face the same way, a rotation about that axis stays undetermined; the cameras' mean up direction decides it.
    """
    mean_up = -down.mean(axis=0)
    levelness = right.T @ right / len(right) - UPRIGHT_GUARD * np.outer(mean_up, mean_up)
    up = np.linalg.eigh(levelness)[1][:, 0]
    return up if up @ mean_up >= 0 else -up


def candidates(
    cover: Cameras,
    message: Cameras,
    points: Float[np.ndarray, "P 3"],
    *,
    cover_points: Float[np.ndarray, "Q 3"] | None = None,
) -> list[Similarity]:
    """At most `CANDIDATES` similarities from the message's world to the cover's, the plain match of both rigs first.

    `points` are the message's. The other candidates take the scales in turn. At each scale come those rotations that
    keep the cover's cameras on sides from which the message was photographed, ordered by how many cells of their
    pictures the message's points fill. `cover_points` help if the cover's optical axes are nearly parallel. Raises
    `ValueError` without cameras.
    """
    cover_rig = rig_of(cover, np.empty((0, 3)) if cover_points is None else cover_points)
    message_rig = rig_of(message, points)
    few = cover.select([cover.names[row] for row in sample(len(cover), SAMPLED_VIEWS)])
    sampled = points[sample(len(points), SAMPLED_POINTS)]
    turns = familiar_turns(few, message, cover_rig, message_rig)
    ranked = []
    for scale in scales(cover_rig, message_rig):
        filled = [cells_filled(few, placement(cover_rig, message_rig, scale, *turn).points(sampled)) for turn in turns]
        ranked.append([(scale, *turns[row]) for row in np.argsort(-np.array(filled), kind="stable")])
    plain = (ranked[0][0][0], 0.0, 0.0)
    choices = dict.fromkeys([plain, *chain.from_iterable(zip(*ranked, strict=True))])
    return [placement(cover_rig, message_rig, *choice) for choice in islice(choices, CANDIDATES)]


def best(
    choices: Sequence[Similarity],
    score: Callable[[Similarity], Score],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Similarity:
    """The choice with the highest score; the first of equals. Raises `ValueError` if there are no choices.

    `progress` receives the number of each choice, from 1, and that of all.
    """
    if not choices:
        raise ValueError("there are no similarities to choose from")
    scores = []
    for number, choice in enumerate(choices, start=1):
        progress(number, len(choices))
        scores.append(score(choice))
    return choices[scores.index(max(scores))]


def cameras_in_message_world(cover: Cameras, message_to_cover: Similarity) -> Cameras:
    """The cover's cameras in the message's world: their pictures show the message as placed in the cover.

    Rendering there leaves the message's splats, spherical harmonics included, unchanged. Depths are in message units.
    """
    return replace(cover, world_to_camera=message_to_cover.inverse().world_to_camera(cover.world_to_camera))


def scales(cover: Rig, message: Rig) -> list[float]:
    """Scales of the message that are worth trying, the nominal one first.

    At the nominal scale both rigs see the same area at their focus. Two more match the picture side on which the
    message falls short, or the distance from the focus. Each is also tried with the factors `ZOOMS`. Scales that would
    bring the cameras too close (`CLOSEST`) are dropped.
    """
    extents = cover.half_extent / message.half_extent
    distances = cover.distance / message.distance
    nominal = (float(np.sqrt(extents.prod())), float(extents.max()), distances)
    tried = [scale * zoom for scale, zoom in product(nominal, ZOOMS)]
    allowed = [scale for scale in tried if scale <= distances / CLOSEST] or [distances]
    return list(dict.fromkeys(round(scale, 12) for scale in allowed))


def familiar_turns(cover: Cameras, message: Cameras, cover_rig: Rig, message_rig: Rig) -> list[tuple[float, float]]:
    """(tilt, turn) pairs, in radians, for which the cover's cameras look from sides the message was photographed from.

    The tilt aligns either gravity (0) or the elevation of the mean views.
    """
    tilts = dict.fromkeys((0.0, cover_rig.elevation - message_rig.elevation))
    tried = [(tilt, 2 * np.pi * step / AZIMUTHS) for tilt, step in product(tilts, range(AZIMUTHS))]
    placed = [placement(cover_rig, message_rig, 1.0, *turn) for turn in tried]
    angles = np.array([stray_angle(cover, message, cover_rig, message_rig, each) for each in placed])
    return [turn for turn, angle in zip(tried, angles, strict=True) if angle <= angles.min() + ANGLE_SLACK]


def placement(cover: Rig, message: Rig, scale: float, tilt: float, turn: float) -> Similarity:
    """Map the message's focus and level axes onto the cover's, after a turn about up and a tilt, in radians.

    The turn comes first; the tilt is about the cover's right axis.
    """
    tilted = Rotation.from_rotvec(tilt * np.array([-1.0, 0.0, 0.0])).as_matrix()
    turned = Rotation.from_rotvec(turn * np.array([0.0, -1.0, 0.0])).as_matrix()
    rotation = cover.axes() @ tilted @ turned @ message.axes().T
    return Similarity(scale, rotation, cover.focus - scale * rotation @ message.focus)


def stray_angle(cover: Cameras, message: Cameras, cover_rig: Rig, message_rig: Rig, placed: Similarity) -> float:
    """Mean angle, in degrees at the focus, from each of the cover's cameras to the nearest of the message's."""
    ours = unit(cover.centres() - cover_rig.focus)
    theirs = unit(placed.directions(message.centres() - message_rig.focus))
    nearest = (ours @ theirs.T).max(axis=1)
    return float(np.degrees(np.arccos(np.clip(nearest, -1, 1))).mean())


def cells_filled(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> float:
    """The fraction of cells that contain at least one point, in a coarse grid over each picture."""
    pixels, depth = project(cameras, points)
    cells = np.floor(pixels / [cameras.width, cameras.height] * GRID)
    seen = (depth > 0) & (cells >= 0).all(axis=-1) & (cells < GRID).all(axis=-1)
    view = np.broadcast_to(np.arange(len(cameras))[:, None], seen.shape)[seen]
    hit = np.zeros((len(cameras), GRID, GRID), dtype=bool)
    hit[view, cells[seen][:, 1].astype(int), cells[seen][:, 0].astype(int)] = True
    return float(hit.mean())


def project(
    cameras: Cameras, points: Float[np.ndarray, "P 3"]
) -> tuple[Float[np.ndarray, "V P 2"], Float[np.ndarray, "V P"]]:
    """Pixel positions and depths of points; positions of points that are not in front of the camera are meaningless."""
    local = points @ cameras.world_to_camera[:, :3, :3].transpose(0, 2, 1) + cameras.world_to_camera[:, None, :3, 3]
    depth = local[..., 2]
    homogeneous = local @ cameras.intrinsics.transpose(0, 2, 1)
    return homogeneous[..., :2] / np.where(np.abs(depth) > 1e-12, depth, 1e-12)[..., None], depth


def sample(total: int, wanted: int) -> np.ndarray:
    """At most `wanted` evenly spread positions out of `total`."""
    return np.unique(np.linspace(0, total - 1, min(total, wanted)).astype(int))


def unit(vectors: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
    """Vectors normalised to length one; zero stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def perpendicular_to(direction: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """A unit vector perpendicular to a unit vector."""
    return unit(np.cross(direction, np.eye(3)[np.abs(direction).argmin()]))
