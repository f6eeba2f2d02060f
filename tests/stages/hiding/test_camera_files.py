"""Cameras as files: read back bit for bit, or refused in one line, without the numbers of a secret camera."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.artifact import create, load
from pipeline.errors import UserError
from stages.hiding.bundle import CAMERAS, IMAGE_CAMERA
from stages.hiding.bundle_files import LARGEST_JSON
from stages.hiding.camera_files import MOST_CAMERAS, cameras_file
from stages.hiding.camera_reading import read_cameras_file
from stages.scene.camera_path import camera_path
from stages.scene.cameras import Cameras
from stages.scene.scene import read_scene
from stages.scene.stored_cameras import read_cameras, write_cameras
from tests.stages import small

POSE = [1.0, 0, 0, 0.5, 0, 1, 0, -2, 0, 0, 1, 4]


def path_of(folder: Path, frames: int = 5) -> Cameras:
    scene = read_scene(small.scene(folder))
    return camera_path(scene.cameras, scene.points, frames)


def same(cameras: Cameras | None, expected: Cameras) -> bool:
    assert cameras is not None
    return all(
        getattr(cameras, name).tobytes() == getattr(expected, name).tobytes()
        for name in ("world_to_camera", "intrinsics")
    ) and (cameras.names, cameras.width, cameras.height) == (expected.names, expected.width, expected.height)


def test_cameras_come_back_bit_for_bit(tmp_path: Path) -> None:
    cameras = path_of(tmp_path / "scene")
    poses = cameras.world_to_camera.copy()
    poses[0, :3, 3] = -0.0, 5e-324, 1e9 / 3
    cameras = replace(cameras, world_to_camera=poses)
    text = cameras_file(cameras)
    (tmp_path / CAMERAS).write_text(text)
    again = read_cameras_file(tmp_path, CAMERAS)
    assert again is not None
    assert same(again, cameras)
    assert cameras_file(again) == text


def test_cameras_come_back_from_the_store(tmp_path: Path) -> None:
    cameras = path_of(tmp_path / "scene")
    for name, known in (("path", cameras), ("none", None)):
        with create(tmp_path / name, "cameras") as writer:
            write_cameras(writer, known)
    assert same(read_cameras(load(tmp_path / "path")), cameras)
    assert read_cameras(load(tmp_path / "none")) is None


def test_as_many_cameras_as_can_be_written_can_be_read(tmp_path: Path) -> None:
    longest = -1.2345678901234567e-300
    poses = np.tile(np.eye(4), (MOST_CAMERAS, 1, 1))
    poses[:, :3][poses[:, :3] == 0] = longest
    cameras = Cameras(
        tuple(f"{number:04d}" for number in range(MOST_CAMERAS)),
        poses,
        np.tile([[200.0, 0, 96], [0, 200, 72], [0, 0, 1]], (MOST_CAMERAS, 1, 1)),
        192,
        144,
    )
    (tmp_path / CAMERAS).write_text(cameras_file(cameras))
    assert (tmp_path / CAMERAS).stat().st_size < LARGEST_JSON
    assert same(read_cameras_file(tmp_path, CAMERAS), cameras)


@pytest.mark.parametrize("of", [np.s_[1:], np.s_[:]])
@pytest.mark.parametrize("entry", [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2)])
def test_several_lenses_or_a_skewed_one_are_no_file(tmp_path: Path, entry: tuple[int, int], of: slice) -> None:
    cameras = path_of(tmp_path / "scene")
    intrinsics = cameras.intrinsics.copy()
    intrinsics[of, *entry] += 1
    changed = replace(cameras, intrinsics=intrinsics)
    if of == np.s_[:] and entry != (0, 1):
        assert json.loads(cameras_file(changed))["lens"] == intrinsics[0][[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    else:
        with pytest.raises(ValueError, match="several lenses"):
            cameras_file(changed)


def test_without_the_file_there_are_none(tmp_path: Path) -> None:
    assert read_cameras_file(tmp_path, CAMERAS) is None
    (tmp_path / "container.ply").write_bytes(b"ply")
    assert read_cameras_file(tmp_path / "container.ply", CAMERAS) is None


def description(**changes: Any) -> dict[str, Any]:
    whole = {
        "format": "gs-hider cameras",
        "version": 1,
        "width": 192,
        "height": 144,
        "lens": [200.0, 200, 96, 72],
        "world_to_camera": [POSE, POSE],
    }
    return {name: value for name, value in (whole | changes).items() if value is not None}


def told(folder: Path, text: str, name: str = CAMERAS) -> str:
    (folder / name).write_text(text)
    with pytest.raises(UserError) as raised:
        read_cameras_file(folder, name)
    said = str(raised.value)
    assert "\n" not in said
    assert len(said) < 600
    return said


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"format": "gs-hider container"}, "the wrong format"),
        ({"version": 2}, "the wrong format"),
        *(({side: value}, "no size") for side in ("width", "height") for value in (None, 0, -4, 1.5, True, 8193, "1")),
        *(({"lens": value}, "no lens") for value in (None, [], [200.0, 200, 96], "200", [[200.0]] * 4, {}, [True] * 4)),
        *(
            ({"lens": [value, 200, 96, 72]}, "no lens")
            for value in (float("nan"), float("inf"), 0, -200, 1e-9, 10**400)
        ),
        ({"lens": [200, 200, 1e300, 72]}, "no lens"),
        ({"lens": [9, 200, 96, 72]}, "no lens"),
        ({"lens": [200, 9, 96, 72]}, "no lens"),
        *(({"world_to_camera": value}, "no list") for value in (None, {}, "poses", 1e9)),
        ({"world_to_camera": []}, "0 of them; expected from 2"),
        ({"world_to_camera": [POSE]}, "1 of them"),
        ({"world_to_camera": [POSE] * (MOST_CAMERAS + 1)}, f"{MOST_CAMERAS + 1} of them"),
        ({"world_to_camera": [POSE, POSE[:11]]}, "number 1"),
        ({"world_to_camera": [POSE, [*POSE, 1]]}, "number 1"),
        ({"world_to_camera": [POSE, [[POSE]] * 12]}, "number 1"),
        ({"world_to_camera": [POSE, [*POSE[:11], float("nan")]]}, "number 1"),
        ({"world_to_camera": [POSE, [*POSE[:11], float("-inf")]]}, "number 1"),
        ({"world_to_camera": [POSE, [*POSE[:11], 10**400]]}, "number 1"),
        ({"world_to_camera": [POSE, [*POSE[:11], 1.01e9]]}, "number 1; expected 12 numbers"),
        ({"world_to_camera": [POSE, [*POSE[:11], "4"]]}, "number 1"),
        ({"world_to_camera": [POSE, [0.0] * 12]}, "no rotation and place, number 1"),
        ({"world_to_camera": [POSE, [1e9] * 12]}, "no rotation and place, number 1"),
        ({"world_to_camera": [[-1.0, *POSE[1:]], POSE]}, "no rotation and place, number 0"),
        ({"world_to_camera": [[2.0, *POSE[1:]], POSE]}, "no rotation and place, number 0"),
    ],
)
def test_what_is_no_camera_is_told(tmp_path: Path, changes: dict[str, Any], expected: str) -> None:
    assert expected in told(tmp_path, json.dumps(description(**changes)))


def test_what_is_no_json_is_told(tmp_path: Path) -> None:
    assert "no JSON" in told(tmp_path, "[" * 10**6)
    assert "no description" in told(tmp_path, "[" * 10**7)
    assert "no description" in told(tmp_path, "[]")
    assert "no JSON" in told(tmp_path, '{"world_to_camera": ' + "1" * 5000 + "}")
    many = json.dumps(description())[:-2] + f", {POSE}" * 10**5 + "]}"
    assert "no description; " in told(tmp_path, many), "more bytes than are read"


def test_a_picture_is_seen_from_one_camera(tmp_path: Path) -> None:
    said = told(tmp_path, json.dumps(description()), IMAGE_CAMERA)
    assert "2 of them; expected one alone" in said
    wrong = [*POSE[:11], 31415.9265]
    wrong[0] = 27182.8182
    said = told(tmp_path, json.dumps(description(world_to_camera=[wrong])), IMAGE_CAMERA)
    assert "31415" not in said, "it is the secret's"
    assert "27182" not in said


@given(data=st.data())
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damage_is_cameras_or_one_error(tmp_path: Path, data: st.DataObject) -> None:
    content = json.dumps(description()).encode()
    place, replaced = data.draw(st.integers(0, len(content))), data.draw(st.integers(0, 40))
    (tmp_path / CAMERAS).write_bytes(content[:place] + data.draw(st.binary(max_size=40)) + content[place + replaced :])
    said = ""
    try:
        read_cameras_file(tmp_path, CAMERAS)
    except UserError as error:
        said = str(error)
    assert "\n" not in said
