"""What a training learns from: its training views, each with its own camera, and nothing that is held out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from stages.hiding.rendering import COVER
from stages.scene.cameras import single_cameras
from stages.scene.scene import read_scene
from stages.training.views import training_views
from tests.stages import small


def test_no_view_that_is_held_out_is_learnt_from(tmp_path: Path) -> None:
    scene = read_scene(small.scene(tmp_path / "scene", test_views=3))
    messages = {"statue": small.pictures(1)}
    views = training_views(scene, messages)
    assert len(views.cameras) == small.VIEWS - 3
    np.testing.assert_array_equal(views.pictures[COVER].numpy(), scene.pictures[3:])
    np.testing.assert_array_equal(views.pictures["statue"].numpy(), messages["statue"][3:])
    for camera, expected in zip(views.cameras, single_cameras(scene.cameras)[3:], strict=True):
        assert torch.equal(camera.world_to_camera, expected.world_to_camera)
