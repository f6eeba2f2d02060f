"""Cameras from any source are refused if no training could use them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import UserError
from stages.scene.camera_checks import FARTHEST, refuse_far_poses
from tests.stages.scene.rigs import arc

UTM = np.array([500123.25, 5400321.5, 310.0])


def test_cameras_in_coordinates_of_a_map_are_refused_with_the_shift_that_helps() -> None:
    with pytest.raises(UserError, match=r"^survey: .*\(500123\.25, 5400321\.5, 311\.5\), all within 4 .*subtract"):
        refuse_far_poses(arc(UTM).world_to_camera, Path("survey"))
    refuse_far_poses(arc(np.zeros(3)).world_to_camera, Path("survey"))


@pytest.mark.parametrize(("share", "refused"), [(0.99, False), (1.01, True)])
def test_the_bound_is_relative_to_how_far_the_cameras_extend(share: float, refused: bool) -> None:
    off = np.array([share * FARTHEST * 40, 0, -1.5])
    poses = arc(off, radius=40.0).world_to_camera
    if refused:
        with pytest.raises(UserError, match="too far from the origin"):
            refuse_far_poses(poses, Path("transforms.json"))
    else:
        refuse_far_poses(poses, Path("transforms.json"))


def test_one_camera_and_cameras_at_one_place_tell_nothing_of_scale() -> None:
    poses = arc(UTM, views=1).world_to_camera
    refuse_far_poses(poses, Path("transforms.json"))
    refuse_far_poses(np.repeat(poses, 3, axis=0), Path("transforms.json"))
