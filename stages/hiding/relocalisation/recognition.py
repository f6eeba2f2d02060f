"""Roughly where a picture was taken from: its landmarks are recognised, and a camera is fitted to them.

The most common way to pass off a picture as another is to mirror it. Descriptors distinguish left from right, so the
mirror image is tried, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from stages.hiding.relocalisation.landmarks import Landmarks, described
from stages.imaging.pictures import Picture
from stages.scene.cameras import Cameras

MOST_OF_A_PICTURE = 600
LEAST_ALIKE = 0.85
"""Inner product of descriptors above which they match; each keypoint of a picture is compared with its best two
landmarks."""

FARTHEST_OFF = (6.0, 3.0, 1.5)
"""Reprojection errors in pixels above which a match is an outlier: in the search and the first fit, then in the two
fits after it."""

LEAST_RECOGNISED = 12
"""Landmarks that must agree on a camera. Occasionally that many agree by chance, which only costs time: what is then
read at a wrong camera is chance as well."""

ATTEMPTS = 5000
"""RANSAC iterations, each with a camera through three matches: if a tenth of the matches are correct, so is one triple
in a thousand. If most are, a few iterations are enough."""

UNCUT, CUT = (0.01, 0.01), (0.2, 0.15)
"""Standard deviations of log focal length and of the principal point (relative to the longer side) from their expected
values: for a picture as the rig takes it, and for a window cropped from one."""

BEYOND_CHANCE = 60
"""If at least this many landmarks agree, the mirror image is not tried. By chance, up to 14 of 600 agreed in mirror
images of renders of the demo, which had 387 and more unmirrored."""

MORE_BY_CUTTING = 1.25
"""A cropped picture must have this many times as many agreeing landmarks as an uncropped one: free parameters always
find some agreement."""

REFERENCE_ERROR = 1.0
"""Usual reprojection error of a landmark, in pixels."""


@dataclass(frozen=True)
class _Matches:
    places: Float64[np.ndarray, "K 2"]
    points: Float64[np.ndarray, "K 3"]


@dataclass(frozen=True)
class Recognition:
    """The `picture`, or its mirror image, and a `camera` named "found" on which `agreeing` landmarks agree."""

    picture: Picture
    camera: Cameras
    agreeing: int


def recognised(picture: Picture, landmarks: Landmarks, intrinsics: Float64[np.ndarray, "3 3"]) -> Recognition | None:
    """The picture or its mirror image, whichever has more agreeing landmarks; None if both have too few.

    `intrinsics` are those of an uncropped picture of the rig; focal length and principal point are fitted, too.
    Deterministic: OpenCV's RANSAC starts from a fixed seed.
    """
    as_it_is = _recognised(picture, landmarks, intrinsics)
    if as_it_is is not None and as_it_is.agreeing >= BEYOND_CHANCE:
        return as_it_is
    mirrored = _recognised(np.ascontiguousarray(picture[:, ::-1]), landmarks, intrinsics)
    either = [each for each in (as_it_is, mirrored) if each is not None]
    return max(either, key=lambda each: each.agreeing, default=None)


def _recognised(picture: Picture, landmarks: Landmarks, intrinsics: Float64[np.ndarray, "3 3"]) -> Recognition | None:
    matches = _matches(picture, landmarks)
    height, width = picture.shape[:2]
    expected = intrinsics.copy()
    expected[:2, 2] = width / 2, height / 2
    start = _searched(matches, expected)
    if start is None:
        return None
    (uncut, agree), (cut, more_agree) = (
        _refined(start, matches, expected, np.array([spreads[0], *[spreads[1] * max(width, height)] * 2]))
        for spreads in (UNCUT, CUT)
    )
    values, count = (cut, more_agree) if more_agree > MORE_BY_CUTTING * agree else (uncut, agree)
    if count < LEAST_RECOGNISED:
        return None
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = Rotation.from_rotvec(values[:3]).as_matrix(), values[3:6]
    camera = Cameras(("found",), world_to_camera[None], _intrinsics(values, expected)[None], width, height)
    return Recognition(picture, camera, count)


def _refined(
    values: Float64[np.ndarray, " 9"],
    matches: _Matches,
    expected: Float64[np.ndarray, "3 3"],
    spreads: Float64[np.ndarray, " 3"],
) -> tuple[Float64[np.ndarray, " 9"], int]:
    """Fit the camera to the matches that agree with it, with decreasing tolerance; also return their final number."""
    believed = np.zeros(len(matches.places), bool)
    for farthest in FARTHEST_OFF:
        believed = (np.linalg.norm(_errors(values, matches, expected), axis=1) < farthest) & _in_front(values, matches)
        if believed.sum() < LEAST_RECOGNISED:
            break
        values = _fitted(values, matches, believed, expected, spreads)
    return values, int(believed.sum())


def _searched(matches: _Matches, expected: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, " 9"] | None:
    """A camera with the expected intrinsics on which most matches agree; None if there is none."""
    if len(matches.places) < LEAST_RECOGNISED:
        return None
    found, turn, step, _ = cv2.solvePnPRansac(
        matches.points,
        matches.places,
        expected,
        None,  # no distortion
        iterationsCount=ATTEMPTS,
        reprojectionError=FARTHEST_OFF[0],
        confidence=0.9999,
        flags=cv2.SOLVEPNP_AP3P,
    )
    return np.concatenate([turn[:, 0], step[:, 0], np.zeros(3)]) if found else None


def _matches(picture: Picture, landmarks: Landmarks) -> _Matches:
    places, looks = described(picture, MOST_OF_A_PICTURE)
    if len(places) == 0 or len(landmarks.points) < 2:
        return _Matches(np.zeros((0, 2)), np.zeros((0, 3)))
    alike = looks @ landmarks.descriptors.T
    rows = np.arange(len(places))
    kept_places, kept_points = [], []
    for _ in range(2):
        best = alike.argmax(axis=1)
        enough = alike[rows, best] > LEAST_ALIKE
        kept_places.append(places[enough])
        kept_points.append(landmarks.points[best[enough]])
        alike[rows, best] = -1
    return _Matches(np.concatenate(kept_places), np.concatenate(kept_points))


def _intrinsics(values: Float64[np.ndarray, " 9"], expected: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3 3"]:
    """Intrinsics from `values`: rotation vector, translation, log focal length, shift of the principal point."""
    intrinsics = expected.copy()
    intrinsics[0, 0] *= np.exp(values[6])
    intrinsics[1, 1] *= np.exp(values[6])
    intrinsics[:2, 2] += values[7:]
    return intrinsics


def _in_front(values: Float64[np.ndarray, " 9"], matches: _Matches) -> Bool[np.ndarray, " K"]:
    return (Rotation.from_rotvec(values[:3]).apply(matches.points) + values[3:6])[:, 2] > 0


def _errors(
    values: Float64[np.ndarray, " 9"], matches: _Matches, expected: Float64[np.ndarray, "3 3"]
) -> Float64[np.ndarray, "K 2"]:
    seen = (Rotation.from_rotvec(values[:3]).apply(matches.points) + values[3:6]) @ _intrinsics(values, expected).T
    return seen[:, :2] / np.where(np.abs(seen[:, 2:]) > 1e-9, seen[:, 2:], 1e-9) - matches.places


def _fitted(
    start: Float64[np.ndarray, " 9"],
    matches: _Matches,
    believed: Bool[np.ndarray, " K"],
    expected: Float64[np.ndarray, "3 3"],
    spreads: Float64[np.ndarray, " 3"],
) -> Float64[np.ndarray, " 9"]:
    own = _Matches(matches.places[believed], matches.points[believed])

    def residuals(values: Float64[np.ndarray, " 9"]) -> Float64[np.ndarray, " R"]:
        errors = _errors(values, own, expected).ravel() / REFERENCE_ERROR
        robust = np.sign(errors) * np.sqrt(2 * (np.sqrt(1 + errors**2) - 1))  # linear for large errors
        return np.concatenate([robust, values[6:] / spreads])

    return np.asarray(least_squares(residuals, start, method="lm").x)  # a third less time per picture than "trf"
