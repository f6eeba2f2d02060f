"""A smooth flight along the cameras of a rig, for a video.

The cameras are ordered by a short tour that stays near cameras: a long step is routed through others. Its bends are
then averaged away, since photographers zigzag and shake. A cubic spline through the averaged positions and a spline on
SO(3) through the averaged orientations form the path. Its horizon is levelled, and its frames are equally spaced.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Float64
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from stages.scene.alignment import Rig, median_depth, rig_of, sample
from stages.scene.cameras import Cameras
from stages.scene.tours import by_way_of_others, longest_step_last, shortest_tour, step_lengths

Course = Literal["auto", "closed", "open"]

CLOSING_STEP = 0.2
"""A tour stays open if its longest step exceeds this fraction of its length, and 1.5 mean steps: closed, it would fly
where nobody looked."""

SAMPLES_A_BEND = 32
"""Samples per bend, of the tour before averaging, and of the path before its frames are taken."""

STEEP, LEVEL = np.sin(np.radians(5)), np.sin(np.radians(45))
"""Sines of the angle between view and vertical: below the first, roll is kept; above the second, the horizon is level.

Above a scene, the picture then turns half as much from frame to frame as with a horizon that is always level."""

LEAST_DISTANCE = 0.5
"""Cameras count as at least this share of the points' median depth away from what they look at. Where a room was
photographed from one place, the optical axes meet in the photographer's hand: its shaking would order the tour."""

MOST_CAMERAS = 400
"""With more cameras, an even sample forms the path: the tour takes time cubic in their number."""


@dataclass(frozen=True)
class Poses:
    """K camera poses: centres in world coordinates and camera-to-world rotations."""

    centres: Float64[np.ndarray, "K 3"]
    rotations: Rotation

    def __len__(self) -> int:
        return len(self.centres)

    def __getitem__(self, rows: np.ndarray | slice) -> Poses:
        return Poses(self.centres[rows], self.rotations[rows])


def camera_path(
    cameras: Cameras, points: Float[np.ndarray, "P 3"], frames: int, bends: int = 16, course: Course = "auto"
) -> Cameras:
    """A path of `frames` cameras along the rig, named by frame number.

    `points` of the scene (P = 0 is allowed) tell how far the cameras look, and so how much a rotation counts relative
    to a step. The path has at most `bends` bends, and no more than there are cameras. A `closed` path, for three
    cameras or more, ends where it begins, without repeating that frame; `auto` closes it if no step of the tour is much
    longer than the others. A single camera stands still. Intrinsics are the median of the rig's. The picture size is
    the rig's, odd sides enlarged by one pixel. Raises `ValueError` without cameras, frames or bends.
    """
    if not len(cameras) or frames < 1 or bends < 1:
        raise ValueError(f"a path of {frames} frames with {bends} bends along {len(cameras)} cameras")
    cameras = cameras.select([cameras.names[row] for row in sample(len(cameras), MOST_CAMERAS)])
    rig = rig_of(cameras, points)
    rig = replace(rig, distance=max(rig.distance, LEAST_DISTANCE * median_depth(cameras, points)))
    poses, closed = _toured(_poses_of(cameras), rig, course)
    path = _levelled(_smooth(poses, rig, min(bends, len(poses)), closed), rig.up)
    return _cameras_of(_evenly(path, rig, frames, closed), cameras)


def _poses_of(cameras: Cameras) -> Poses:
    return Poses(cameras.centres(), Rotation.from_matrix(cameras.world_to_camera[:, :3, :3].transpose(0, 2, 1)))


def _features(poses: Poses, distance: float) -> Float64[np.ndarray, "K 6"]:
    """Points whose distance measures how much two views differ: centre, in viewing distances, and direction."""
    directions = poses.rotations.apply([0.0, 0.0, 1.0]).reshape(-1, 3)
    return np.concatenate([poses.centres / distance, directions], axis=1)


def _toured(poses: Poses, rig: Rig, course: Course) -> tuple[Poses, bool]:
    """The poses along a tour, and whether it is closed; an open one is cut at its longest step.

    Poses on the way of a long step are visited again. Otherwise, among the bonsai's photos, taken up and down all
    around it, the two longest steps would cross where nobody looked from, as far from any camera as cameras are from
    the focus.
    """
    features = _features(poses, rig.distance)
    order = longest_step_last(features, shortest_tour(features))
    steps = step_lengths(np.append(features[order], features[order[:1]], axis=0))
    evenly = bool(steps[-1] <= max(CLOSING_STEP, 1.5 / len(poses)) * steps.sum())
    closed = {"auto": evenly, "closed": True, "open": False}[course] and len(poses) > 2
    way = by_way_of_others(features, np.append(order, order[0]) if closed else order)
    return poses[way[:-1] if closed else way], closed


def _smooth(poses: Poses, rig: Rig, bends: int, closed: bool) -> Poses:
    """Dense samples of the splines through the averaged poses of a tour."""
    evenly = _evenly(poses, rig, bends * SAMPLES_A_BEND, closed)
    keys = _averages(evenly, bends, closed)
    return _splined(keys, closed) if len(keys) > 1 else keys


def _evenly(poses: Poses, rig: Rig, count: int, closed: bool) -> Poses:
    """`count` poses equally spaced along a tour, by linear interpolation and slerp between its poses."""
    if closed:
        poses = poses[np.append(np.arange(len(poses)), 0)]
    places = np.append(0, np.cumsum(step_lengths(_features(poses, rig.distance))))
    apart = np.append(True, np.diff(places) > 0)  # a step may be too short to change the sum
    poses, places = poses[apart], places[apart]
    if len(poses) < 2:
        return poses[np.zeros(count, int)]
    at = np.linspace(0, places[-1], count, endpoint=not closed)
    centres = np.stack([np.interp(at, places, axis) for axis in poses.centres.T], axis=1)
    return Poses(centres, Slerp(places, poses.rotations)(at))


def _averages(poses: Poses, bends: int, closed: bool) -> Poses:
    """`bends` poses along many: Gaussian-weighted means, with half the spacing as standard deviation."""
    count = len(poses)
    middles = np.linspace(0, count - (0 if closed else 1), bends, endpoint=not closed)
    away = np.abs(np.arange(count) - middles[:, None])
    if closed:
        away = np.minimum(away, count - away)
    weights = np.exp(-0.5 * (away / (0.5 * count / bends)) ** 2)
    weights /= weights.sum(axis=1, keepdims=True)
    means = [poses.rotations.mean(row) for row in weights]
    return Poses(weights @ poses.centres, Rotation.concatenate(means))


def _splined(keys: Poses, closed: bool) -> Poses:
    """Dense samples of the splines through K key poses; a closed path does not repeat its first."""
    count = len(keys)
    at = np.linspace(0, count if closed else count - 1, count * SAMPLES_A_BEND, endpoint=not closed)
    if not closed:
        places = np.arange(count)
        return Poses(CubicSpline(places, keys.centres)(at), RotationSpline(places, keys.rotations)(at))
    # One more lap before and after: the spline on SO(3) has no periodic ends; their effect fades within a few keys.
    places = np.arange(-count, 2 * count + 1)
    around = keys[places % count]
    ring = keys.centres[np.arange(count + 1) % count]
    centres = CubicSpline(np.arange(count + 1), ring, bc_type="periodic")(at)
    return Poses(centres, RotationSpline(places, around.rotations)(at))


def _levelled(poses: Poses, up: Float[np.ndarray, " 3"]) -> Poses:
    """The poses with roll removed, but less and less towards views straight up or down, where there is no horizon."""
    right, down, view = (poses.rotations.apply(axis).reshape(-1, 3) for axis in np.eye(3))
    roll = np.arctan2(right @ up, -(down @ up))
    steepness = (np.linalg.norm(np.cross(view, up), axis=1) - STEEP) / (LEVEL - STEEP)
    share = np.clip(steepness, 0, 1) ** 2 * (3 - 2 * np.clip(steepness, 0, 1))
    return Poses(poses.centres, Rotation.from_rotvec((share * roll)[:, None] * view) * poses.rotations)


def _cameras_of(poses: Poses, rig: Cameras) -> Cameras:
    rotation = poses.rotations.as_matrix().transpose(0, 2, 1)
    world_to_camera = np.tile(np.eye(4), (len(poses), 1, 1))
    world_to_camera[:, :3, :3] = rotation
    world_to_camera[:, :3, 3] = -np.einsum("kij,kj->ki", rotation, poses.centres)
    lens = np.median(rig.intrinsics, axis=0)
    return Cameras(
        tuple(f"{frame:04d}" for frame in range(len(poses))),
        world_to_camera,
        np.tile(lens, (len(poses), 1, 1)),
        rig.width + rig.width % 2,
        rig.height + rig.height % 2,
    )
