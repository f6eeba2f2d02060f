"""Placing a message in the cover's world: similarities under which the cover's cameras see the message well.

A rig of cameras is summed up by where it looks (focus), which way is up, from which side it looks, how far away it
stands and how much it sees there. A candidate brings the message's focus onto the cover's, up onto up, and turns and
scales the rest. Which candidate fills the cover's pictures best only rendering can tell, so the caller scores them.
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

CANDIDATES = 24  # that a caller is given to score, at most
AZIMUTHS = 24  # turns about the up axis that are tried
ZOOMS = (1.0, 1.2, 1.4, 0.85)  # how much larger than the nominal scale the message is tried
CLOSEST = 0.6  # no candidate brings the cameras closer to the focus than this share of the message's own distance
ANGLE_SLACK = 10.0  # degrees; turns that are this much worse than the best at keeping to the message's views are tried
PARALLEL_GUARD = 0.01  # weight of the points' median depth against the crossing of the optical axes
UPRIGHT_GUARD = 0.005  # weight of the mean camera's up direction against level horizons
GRID = 8  # cells a side, for the quick estimate of coverage
SAMPLED_VIEWS = 12
SAMPLED_POINTS = 2000
NEAREST = 0.02  # quantile of depths that counts as the nearest


class Comparable(Protocol):
    def __lt__(self, other: Any, /) -> bool: ...


Score = TypeVar("Score", bound=Comparable)


@dataclass(frozen=True)
class Rig:
    """What V cameras look at and how, in world coordinates; `up` and `forward` are perpendicular unit vectors."""

    focus: Float[np.ndarray, " 3"]
    up: Float[np.ndarray, " 3"]
    forward: Float[np.ndarray, " 3"]
    elevation: float  # radians by which the mean view looks down
    distance: float  # median distance of the cameras from the focus
    half_extent: Float[np.ndarray, " 2"]  # half the width and height that is seen at the focus

    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Right, down and level forward as columns: the camera convention, with a level horizon."""
        return np.stack([np.cross(self.forward, self.up), -self.up, self.forward], axis=1)


def rig_of(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> Rig:
    """Sum up a rig. `points` (P = 0 is allowed) only tell how far parallel optical axes look.

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
    """The point closest to all optical axes, in the least squares.

    Nearly parallel axes cross nowhere, or far away: a small weight pulls towards the points' median depth in front of
    the cameras.
    """
    centres, views = cameras.centres(), cameras.world_to_camera[:, 2, :3]
    across = np.eye(3) - views[:, :, None] * views[:, None, :]
    looked_at = centres + views * median_depth(cameras, points)
    left = across.mean(axis=0) + PARALLEL_GUARD * np.eye(3)
    right = np.einsum("vij,vj->i", across, centres) / len(cameras) + PARALLEL_GUARD * looked_at.mean(axis=0)
    return np.linalg.solve(left, right)


def median_depth(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> float:
    """The median depth of the points that lie within the cameras' pictures, over all cameras.

    Where no camera sees a point: twice the distance of the outermost camera from the mean of them, or 1 for one camera.
    """
    depths = depths_seen(cameras, points)
    if len(depths):
        return float(np.median(depths))
    centres = cameras.centres()
    return 2 * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()) or 1.0


def nearest_depth(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> float:
    """How near the cameras' pictures show anything: a low quantile of the depths of points, as a few points err.

    0 where no camera sees a point.
    """
    depths = depths_seen(cameras, points)
    return float(np.quantile(depths, NEAREST)) if len(depths) else 0.0


def depths_seen(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " n"]:
    """Depths of the points, of many a sample, that lie within each camera's picture."""
    pixels, depth = project(cameras, points[sample(len(points), SAMPLED_POINTS)])
    size = np.array([cameras.width, cameras.height])
    return depth[(depth > 0) & (pixels >= 0).all(axis=-1) & (pixels < size).all(axis=-1)]


def up_direction(right: Float[np.ndarray, "V 3"], down: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " 3"]:
    """The direction that keeps the horizons of all pictures most level, on the side of the cameras' own up.

    Photographers hold a camera level: its right is perpendicular to gravity's up, also where it looks down. Where all
    cameras face the same way that leaves a turn open, which their mean up decides.
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
    """At most `CANDIDATES` similarities from the message's world into the cover's, the plain match of both rigs first.

    `points` are the message's. The others are, for one scale after the other, the turns and tilts that keep the
    cover's cameras to sides from which the message was photographed and fill most cells of their pictures with points
    of the message. `cover_points` help where the cover's optical axes are nearly parallel. Raises `ValueError` without
    cameras.
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


def best(choices: Sequence[Similarity], score: Callable[[Similarity], Score]) -> Similarity:
    """The choice of the highest score, the earliest of equals. Raises `ValueError` for no choices."""
    if not choices:
        raise ValueError("there are no similarities to choose from")
    return max(choices, key=score)


def cameras_in_message_world(cover: Cameras, message_to_cover: Similarity) -> Cameras:
    """The cover's cameras, carried into the message's world: their pictures show the message as placed in the cover.

    Rendering the message so leaves its splats untouched, spherical harmonics included. Depths are in message units.
    """
    return replace(cover, world_to_camera=message_to_cover.inverse().world_to_camera(cover.world_to_camera))


def scales(cover: Rig, message: Rig) -> list[float]:
    """Scales of the message that are worth trying, the nominal one first.

    At the nominal scale both rigs see as much at their focus, in area; others match the wanting side of the picture,
    or the distance; and each of these somewhat larger or smaller.
    """
    extents = cover.half_extent / message.half_extent
    distances = cover.distance / message.distance
    nominal = (float(np.sqrt(extents.prod())), float(extents.max()), distances)
    tried = [scale * zoom for scale, zoom in product(nominal, ZOOMS)]
    allowed = [scale for scale in tried if scale <= distances / CLOSEST] or [distances]
    return list(dict.fromkeys(round(scale, 12) for scale in allowed))


def familiar_turns(cover: Cameras, message: Cameras, cover_rig: Rig, message_rig: Rig) -> list[tuple[float, float]]:
    """Tilts and turns, in radians, under which the cover's cameras look from sides that the message's looked from.

    Tilts bring gravity onto gravity, or the mean view onto the mean view.
    """
    tilts = dict.fromkeys((0.0, cover_rig.elevation - message_rig.elevation))
    tried = [(tilt, 2 * np.pi * step / AZIMUTHS) for tilt, step in product(tilts, range(AZIMUTHS))]
    placed = [placement(cover_rig, message_rig, 1.0, *turn) for turn in tried]
    angles = np.array([stray_angle(cover, message, cover_rig, message_rig, each) for each in placed])
    return [turn for turn, angle in zip(tried, angles, strict=True) if angle <= angles.min() + ANGLE_SLACK]


def placement(cover: Rig, message: Rig, scale: float, tilt: float, turn: float) -> Similarity:
    """Focus onto focus; level axes onto level axes, then turned about up and tilted about the cover's right."""
    tilted = Rotation.from_rotvec(tilt * np.array([-1.0, 0.0, 0.0])).as_matrix()
    turned = Rotation.from_rotvec(turn * np.array([0.0, -1.0, 0.0])).as_matrix()
    rotation = cover.axes() @ tilted @ turned @ message.axes().T
    return Similarity(scale, rotation, cover.focus - scale * rotation @ message.focus)


def stray_angle(cover: Cameras, message: Cameras, cover_rig: Rig, message_rig: Rig, placed: Similarity) -> float:
    """Mean over the cover's cameras of the angle, seen from the focus, to the nearest of the message's, in degrees."""
    ours = unit(cover.centres() - cover_rig.focus)
    theirs = unit(placed.directions(message.centres() - message_rig.focus))
    nearest = (ours @ theirs.T).max(axis=1)
    return float(np.degrees(np.arccos(np.clip(nearest, -1, 1))).mean())


def cells_filled(cameras: Cameras, points: Float[np.ndarray, "P 3"]) -> float:
    """The share of the cells of a coarse grid over each picture that hold at least one point."""
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
    """Pixel positions and depths; positions of points that are not in front are meaningless."""
    local = points @ cameras.world_to_camera[:, :3, :3].transpose(0, 2, 1) + cameras.world_to_camera[:, None, :3, 3]
    depth = local[..., 2]
    homogeneous = local @ cameras.intrinsics.transpose(0, 2, 1)
    return homogeneous[..., :2] / np.where(np.abs(depth) > 1e-12, depth, 1e-12)[..., None], depth


def sample(total: int, wanted: int) -> np.ndarray:
    """At most `wanted` positions of `total`, evenly spread."""
    return np.unique(np.linspace(0, total - 1, min(total, wanted)).astype(int))


def unit(vectors: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
    """Vectors of length one; zero stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def perpendicular_to(direction: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Some unit vector perpendicular to a unit vector."""
    return unit(np.cross(direction, np.eye(3)[np.abs(direction).argmin()]))
