from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from stages.scene.cameras import Cameras
from stages.scene.pose_errors import align_cameras, pose_errors, rig_radius, rotation_angles
from stages.scene.similarity import Similarity
from tests.stages.scene.rigs import arc, moved, similarities


@given(similarities())
def test_a_carried_rig_has_no_errors(similarity: Similarity) -> None:
    true = arc(np.array([1.0, 2.0, 0.5]))
    errors = pose_errors(moved(true, similarity), true)
    assert errors.position.max() < 1e-6
    assert errors.rotation.max() < 1e-4


def test_cameras_are_paired_by_name_and_not_by_position() -> None:
    true = arc(np.zeros(3))
    shuffled = true.select([true.names[row] for row in np.random.default_rng(0).permutation(len(true))[:9]])
    assert pose_errors(shuffled, true).position.max() < 1e-9


def test_errors_are_what_was_put_in() -> None:
    true = arc(np.zeros(3), views=64)
    poses = true.world_to_camera.copy()
    poses[5, :3, :3] = Rotation.from_rotvec([0, 0, np.radians(2.0)]).as_matrix() @ poses[5, :3, :3]
    poses[5, :3, 3] = -poses[5, :3, :3] @ (true.centres()[5] + [0, 0, 0.1 * rig_radius(true)])
    errors = pose_errors(Cameras(true.names, poses, true.intrinsics, true.width, true.height), true)
    assert errors.position.argmax() == errors.rotation.argmax() == 5
    assert errors.position[5] == pytest.approx(0.1, rel=0.05)
    assert errors.rotation[5] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("degrees", [0.0, 1e-4, 1.0, 90.0, 179.0])
def test_angles(degrees: float) -> None:
    axis = np.array([1.0, 2.0, -2.0]) / 3
    turn = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
    assert rotation_angles(turn[None])[0] == pytest.approx(degrees, abs=1e-9)


def test_rigs_without_shared_names_are_refused() -> None:
    true = arc(np.zeros(3))
    other = Cameras(
        tuple(f"other {name}" for name in true.names), true.world_to_camera, true.intrinsics, true.width, true.height
    )
    with pytest.raises(ValueError, match="three pairs"):
        align_cameras(other, true)
