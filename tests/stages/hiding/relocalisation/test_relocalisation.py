"""A picture's camera is found to a fraction of a pixel, even if the picture is cropped; other pictures have none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from stages.hiding.relocalisation.alignment import aligned
from stages.hiding.relocalisation.landmarks import Landmarks, described, landmarks
from stages.hiding.relocalisation.recognition import recognised
from stages.scene.cameras import Cameras
from tests.stages.hiding.relocalisation.scenes import beside, cloud, photograph, rig

GAUSSIANS, METHOD = cloud()
RIG = rig()
EXPECTED = np.median(RIG.intrinsics, axis=0)


@cache
def known() -> Landmarks:
    return landmarks(GAUSSIANS, METHOD, RIG)


def seen(camera: Cameras) -> np.ndarray:
    """Where the camera sees the landmarks, in pixels."""
    places = (known().points @ camera.world_to_camera[0, :3, :3].T + camera.world_to_camera[0, :3, 3]) @ (
        camera.intrinsics[0].T
    )
    return places[:, :2] / places[:, 2:]


def off(found: Cameras, true: Cameras) -> float:
    """The mean error in pixels of the landmarks that the true camera's picture shows."""
    wanted = seen(true)
    inside = ((wanted > 0) & (wanted < [true.width, true.height])).all(axis=1)
    return float(np.linalg.norm(seen(found)[inside] - wanted[inside], axis=1).mean())


def test_landmarks_are_seen_where_they_were_found() -> None:
    picture = photograph(GAUSSIANS, METHOD, RIG.select(["0"]))
    own = landmarks(GAUSSIANS, METHOD, RIG.select(["0"]))
    places, looks = described(picture, 300)
    camera = RIG.select(["0"])
    shown = (own.points @ camera.world_to_camera[0, :3, :3].T + camera.world_to_camera[0, :3, 3]) @ EXPECTED.T
    distances = np.linalg.norm(shown[:, None, :2] / shown[:, None, 2:] - places[None], axis=2).min(axis=1)
    assert len(own.points) > 50
    assert distances.max() < 1e-3
    np.testing.assert_allclose((looks**2).sum(axis=1), 1, rtol=1e-5)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("cut", [False, True])
def test_the_camera_of_a_picture_is_found(cut: bool, mirrored: bool) -> None:
    true = beside(RIG)
    picture = photograph(GAUSSIANS, METHOD, true)
    if cut:
        picture = picture[10:82, 20:116].copy()
        intrinsics = true.intrinsics.copy()
        intrinsics[:, :2, 2] -= 20, 10
        true = replace(true, intrinsics=intrinsics, width=96, height=72)
    shown = picture[:, ::-1].copy() if mirrored else picture
    guessed = recognised(shown, known(), EXPECTED)
    assert guessed is not None
    np.testing.assert_array_equal(guessed.picture, picture)
    assert off(guessed.camera, true) < 3
    found = aligned(picture, GAUSSIANS, METHOD, guessed.camera)
    assert off(found, true) < 0.01
    again = recognised(shown, known(), EXPECTED)
    assert again is not None
    np.testing.assert_array_equal(again.camera.world_to_camera, guessed.camera.world_to_camera)


def test_other_pictures_are_of_no_camera() -> None:
    stranger, method = cloud(seed=7)
    assert recognised(photograph(stranger, method, RIG.select(["0"])), known(), EXPECTED) is None
    assert recognised(np.full((96, 128, 3), 90, np.uint8), known(), EXPECTED) is None


def test_without_landmarks_nothing_is_recognised() -> None:
    none = Landmarks(np.zeros((0, 3)), np.zeros((0, 128), np.float32))
    assert recognised(photograph(GAUSSIANS, METHOD, RIG.select(["0"])), none, EXPECTED) is None
    empty = type(GAUSSIANS)({name: values[:0] for name, values in GAUSSIANS.parameters.items()})
    assert len(landmarks(empty, METHOD, RIG).points) == 0
