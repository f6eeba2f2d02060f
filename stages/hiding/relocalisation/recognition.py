"""About where a picture was taken: its landmarks are recognised, and a camera is fitted to them.

The commonest way to pass a picture off as another is to mirror it, and descriptors tell left from right: so the mirror
image is looked at, too.
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
"""Products of descriptors from here on count as a match; of each place in a picture the best two landmarks do."""

FARTHEST_OFF = (6.0, 3.0, 1.5)
"""Pixels off from which a match is not believed: in the search and the first fit, and in the two fits after it."""

LEAST_RECOGNISED = 12
"""Landmarks that must agree on a camera. Now and then that many do by chance, which costs time alone: what is read at a
wrong camera is chance as well."""

ATTEMPTS = 5000
"""Of the search, each with a camera through three matches: where a tenth of the matches are true, one triple in a
thousand is. Where most are, a few attempts tell."""

UNCUT, CUT = (0.01, 0.01), (0.2, 0.15)
"""How far focal length (in its logarithm) and centre (in longer sides) may be from what is expected: of a picture as
the rig takes them, and of a window that was cut out of one."""

BEYOND_CHANCE = 60
"""Landmarks: where so many agree, the mirror image is not looked at. By chance up to 14 of 600 did in mirror images of
renders of the demo, which as they are had 387 and more."""

MORE_BY_CUTTING = 1.25
"""Times as many landmarks must agree on a cut picture as on an uncut one: free parameters find agreement everywhere."""

REFERENCE_ERROR = 1.0
"""Pixels that a landmark is off by where all is well."""


@dataclass(frozen=True)
class _Matches:
    places: Float64[np.ndarray, "K 2"]
    points: Float64[np.ndarray, "K 3"]


@dataclass(frozen=True)
class Recognition:
    """The `picture`, or its mirror image, and a `camera`, named "found", that sees `agreeing` landmarks where it has
    them."""

    picture: Picture
    camera: Cameras
    agreeing: int


def recognised(picture: Picture, landmarks: Landmarks, intrinsics: Float64[np.ndarray, "3 3"]) -> Recognition | None:
    """The picture or its mirror image, on whose camera more landmarks agree; None where too few do on either's.

    `intrinsics` are those expected of an uncut picture of the rig; focal length and centre are fitted, too. The same
    picture gives the same camera: OpenCV's search for a consensus starts from one constant.
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
    """The camera fitted to the matches that agree with it, ever nearer ones, and how many do in the end."""
    believed = np.zeros(len(matches.places), bool)
    for farthest in FARTHEST_OFF:
        believed = (np.linalg.norm(_errors(values, matches, expected), axis=1) < farthest) & _in_front(values, matches)
        if believed.sum() < LEAST_RECOGNISED:
            break
        values = _fitted(values, matches, believed, expected, spreads)
    return values, int(believed.sum())


def _searched(matches: _Matches, expected: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, " 9"] | None:
    """A camera with the expected intrinsics that most matches agree on; None without one."""
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
    """Of a turn, a step, a zoom's logarithm, and a shift of the centre in pixels."""
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
        robust = np.sign(errors) * np.sqrt(2 * (np.sqrt(1 + errors**2) - 1))  # large errors count by their length alone
        return np.concatenate([robust, values[6:] / spreads])

    return np.asarray(least_squares(residuals, start, method="lm").x)  # a third less time for a picture than by "trf"
