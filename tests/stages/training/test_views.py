"""A training learns from its training views, each with its own camera, and from nothing that is held out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.errors import UserError
from stages.add_grain import AddGrainParameters, add_grain
from stages.hide_image import chosen_view
from stages.hiding.rendering import COVER
from stages.hiding.watermark.reading import owners_reader
from stages.scene.cameras import single_cameras
from stages.scene.scene import read_scene
from stages.training.views import training_views
from tests.running import run_stage
from tests.stages import small
from tests.stages.test_hide_image import key_of


def test_no_view_that_is_held_out_is_learnt_from(tmp_path: Path) -> None:
    scene = read_scene(small.scene(tmp_path / "scene", test_views=3))
    messages = {"statue": small.pictures(1)}
    views = training_views(scene, messages)
    assert len(views.cameras) == small.VIEWS - 3
    np.testing.assert_array_equal(torch.stack([*views.pictures[COVER]]), scene.pictures[3:])
    np.testing.assert_array_equal(torch.stack([*views.pictures["statue"]]), messages["statue"][3:])
    for name, held in ((COVER, scene.pictures), ("statue", messages["statue"])):
        assert all(np.shares_memory(picture.numpy(), held) for picture in views.pictures[name]), "gigabytes, once"
    for camera, expected in zip(views.cameras, single_cameras(scene.cameras)[3:], strict=True):
        assert torch.equal(camera.world_to_camera, expected.world_to_camera)


def test_a_scene_of_test_views_alone_is_told(tmp_path: Path) -> None:
    """`import_scene` accepts such a scene, since it can be evaluated on."""
    cover, before = small.scene(tmp_path / "scene", test_views=small.VIEWS), small.splats(tmp_path / "splats")
    scene, key, inputs = read_scene(cover), key_of(tmp_path, 0), {"container": before, "cover": cover}
    for learn in (
        lambda: training_views(scene),
        lambda: chosen_view(scene, None, key),
        lambda: run_stage(add_grain, AddGrainParameters(method="plain"), inputs, tmp_path / "grain"),
        lambda: owners_reader(before, scene, None, 0),
    ):
        with pytest.raises(UserError, match="no training view; found 8 views, all of them test views"):
            learn()


def test_a_message_in_pictures_of_another_size_is_refused_and_not_named(tmp_path: Path) -> None:
    """Views are paired with the cover's by name alone, and two scenes of one capture have the same names."""
    scene = read_scene(small.scene(tmp_path / "scene"))
    larger = small.pictures(1).repeat(2, axis=1).repeat(2, axis=2)
    with pytest.raises(UserError, match="found 8 of 64 x 48 pixels; expected 8 of 32 x 24 pixels") as raised:
        training_views(scene, {"statue": larger})
    assert "statue" not in str(raised.value)
