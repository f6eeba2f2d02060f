"""`synthesize`: a complete capture, the same bytes for the same seed, and no parameters that make no sense."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from pipeline.artifact import Artifact
from pipeline.errors import Interrupted
from pipeline.stage import Services
from stages.imaging.pictures import read_picture
from stages.scene.capture import picture_path, read_capture
from stages.synthesize import SynthesizeParameters, synthesize
from stages.tracing.rig import orbit
from tests.running import run_stage

SMALL = {"scene": "courtyard", "views": 3, "width": 48, "height": 36, "samples": 1, "processes": 1}


def capture(directory: Path, **changes: object) -> Artifact:
    return run_stage(synthesize, SynthesizeParameters(**SMALL | changes), {}, directory)["capture"]


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Artifact:
    return capture(tmp_path_factory.mktemp("taken"))


def test_a_capture_says_all_that_a_camera_would(taken: Artifact) -> None:
    known = read_capture(taken)
    assert known.names == ("000.png", "001.png", "002.png")
    assert known.sizes == ((48, 36),) * 3
    poses, intrinsics = orbit(3, 48, 36, 0)
    assert known.focal_pixels == tuple(intrinsics[:, 0, 0])
    assert known.ordered
    assert known.poses is not None
    assert known.poses.source == "synthetic"
    assert known.poses.world_to_camera.dtype == np.float64
    assert np.array_equal(known.poses.world_to_camera, poses)
    assert np.array_equal([lens.matrix() for lens in known.poses.lenses], intrinsics)
    for name in known.names:
        assert read_picture(picture_path(taken, name)).shape == (36, 48, 3)


def test_the_same_parameters_give_the_same_bytes_for_any_number_of_processes(taken: Artifact, tmp_path: Path) -> None:
    assert capture(tmp_path, processes=2).digest == taken.digest


def test_another_seed_gives_other_pictures_and_poses(taken: Artifact, tmp_path: Path) -> None:
    other = capture(tmp_path, seed=1)
    assert not np.array_equal(other.read("world_to_camera"), taken.read("world_to_camera"))
    for name in other.attributes["names"]:
        assert picture_path(other, name).read_bytes() != picture_path(taken, name).read_bytes()


def test_a_stop_is_heeded(tmp_path: Path) -> None:
    services = replace(Services(), stop_requested=lambda: True)
    with pytest.raises(Interrupted):
        run_stage(synthesize, SynthesizeParameters(**SMALL), {}, tmp_path, services=services)


@pytest.mark.parametrize(
    ("name", "value"), [("scene", "castle"), ("samples", 5), ("views", 0), ("gloss", 1.5), ("seed", -1), ("colour", 1)]
)
def test_parameters_refuse_what_makes_no_sense(name: str, value: object) -> None:
    with pytest.raises(ValidationError, match=name):
        SynthesizeParameters(**SMALL | {name: value})
