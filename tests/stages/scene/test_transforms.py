from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.errors import UserError
from stages.scene import transforms
from stages.scene.lens import Lens
from stages.scene.transforms import read_transforms

MATRIX = [[1.0, 0, 0, 4], [0, 0, -1.0, 5], [0, 1.0, 0, 6], [0, 0, 0, 1]]  # looks along +y with +z up


def write(folder: Path, frames: list[dict], **shared: object) -> Path:
    path = folder / "transforms.json"
    path.write_text(json.dumps({**shared, "frames": frames}))
    return path


def size_of(name: str) -> tuple[int, int]:
    return (640, 480)


def test_opengl_cameras_become_opencv_cameras(tmp_path: Path) -> None:
    path = write(tmp_path, [{"file_path": "./images/7", "transform_matrix": MATRIX}], camera_angle_x=math.pi / 2)
    (photo,) = read_transforms(path, size_of)
    pose = photo.world_to_camera
    assert photo.name == "images/7"
    np.testing.assert_allclose(-pose[:3, :3].T @ pose[:3, 3], [4, 5, 6], atol=1e-12)
    np.testing.assert_allclose(pose[:3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-12)  # right, down, forward
    np.testing.assert_allclose(photo.lens.matrix(), [[320, 0, 320], [0, 320, 240], [0, 0, 1]])


def test_rounded_rotations_become_rotations(tmp_path: Path) -> None:
    """Files often have few decimals, which no renderer may take for a shear."""
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec([0.3, -0.7, 1.1]).as_matrix()
    frame = {"file_path": "a", "transform_matrix": turned.round(3).tolist()}
    pose = read_transforms(write(tmp_path, [frame], fl_x=100.0), size_of)[0].world_to_camera
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.diag([1, -1, -1]) @ pose[:3, :3], turned[:3, :3].T, atol=1e-3)


def test_an_angle_is_the_same_for_resized_photos(tmp_path: Path) -> None:
    """Only intrinsics in pixels need the size that they refer to."""
    path = write(tmp_path, [{"file_path": "a", "transform_matrix": MATRIX}], camera_angle_x=math.pi / 2)
    assert read_transforms(path, size_of, resized=True)[0].lens.parameters[:2] == pytest.approx((320, 320))
    path = write(tmp_path, [{"file_path": "a", "transform_matrix": MATRIX}], fl_x=320.0)
    with pytest.raises(UserError, match="w and h are missing"):
        read_transforms(path, size_of, resized=True)


def test_a_frames_own_intrinsics_come_first(tmp_path: Path) -> None:
    own = {"file_path": "b.png", "transform_matrix": MATRIX, "fl_x": 300.0, "fl_y": 310.0, "cx": 1.0, "cy": 2.0}
    shared = {"fl_x": 100.0, "w": 50, "h": 40, "k1": 0.1}
    path = write(tmp_path, [own, {"file_path": "a.png", "transform_matrix": MATRIX[:3]}], **shared)
    first, second = read_transforms(path, size_of)
    assert first.lens.parameters == (100.0, 100.0, 25.0, 20.0, 0.1, 0.0, 0.0, 0.0)
    assert second.lens.parameters == (300.0, 310.0, 1.0, 2.0, 0.1, 0.0, 0.0, 0.0)
    assert (second.lens.width, second.lens.height) == (50, 40)


@pytest.mark.parametrize("given", [{"fl_y": 90.0}, {"camera_angle_y": 2 * math.atan(20 / 90)}])
def test_a_focal_length_along_one_axis_is_that_of_both(tmp_path: Path, given: dict[str, float]) -> None:
    path = write(tmp_path, [{"file_path": "a.png", "transform_matrix": MATRIX}], w=50, h=40, **given)
    assert read_transforms(path, size_of)[0].lens.parameters[:2] == pytest.approx((90.0, 90.0))


def test_a_frames_own_angle_comes_before_the_focal_length_of_all(tmp_path: Path) -> None:
    frame = {"file_path": "a.png", "transform_matrix": MATRIX, "camera_angle_x": math.pi / 2}
    (photo,) = read_transforms(write(tmp_path, [frame], fl_x=100.0, fl_y=110.0, w=50, h=40), size_of)
    assert photo.lens.parameters[:2] == pytest.approx((25.0, 110.0))


def test_a_focal_length_in_pixels_comes_before_the_angle_beside_it(tmp_path: Path) -> None:
    """Files often have both; the angle is that of a picture without distortion."""
    shared = {"fl_x": 100.0, "fl_y": 110.0, "camera_angle_x": 0.4, "camera_angle_y": 0.4}
    path = write(tmp_path, [{"file_path": "a.png", "transform_matrix": MATRIX}], w=50, h=40, **shared)
    assert read_transforms(path, size_of)[0].lens.parameters[:2] == (100.0, 110.0)


@pytest.mark.parametrize(
    ("given", "model", "distortion"),
    [
        ({"camera_model": "OPENCV_FISHEYE", "k3": 0.3}, "OPENCV_FISHEYE", (0.0, 0.0, 0.3, 0.0)),
        ({"k3": 0.3}, "FULL_OPENCV", (0.0, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0)),
        ({"camera_model": "PINHOLE"}, "PINHOLE", ()),
        ({"camera_model": "SIMPLE_PINHOLE", "k1": 0.0}, "PINHOLE", ()),
        ({"camera_model": "SIMPLE_RADIAL", "k1": 0.5, "k2": 0}, "OPENCV", (0.5, 0.0, 0.0, 0.0)),
        ({"camera_model": "RADIAL", "k1": 0.5, "k2": 0.4}, "OPENCV", (0.5, 0.4, 0.0, 0.0)),
        ({"is_fisheye": True, "k1": 0.5, "k4": 0.4, "p1": 0}, "OPENCV_FISHEYE", (0.5, 0.0, 0.0, 0.4)),
        ({"is_fisheye": False, "k1": 0.5, "k4": 0.0, "p1": 9}, "OPENCV", (0.5, 0.0, 9.0, 0.0)),
        ({"latlong": False, "equirectangular": False}, "OPENCV", (0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_lens_models(tmp_path: Path, given: dict, model: str, distortion: tuple) -> None:
    path = write(tmp_path, [{"file_path": "a", "transform_matrix": MATRIX}], fl_x=100.0, **given)
    lens = read_transforms(path, size_of)[0].lens
    assert (lens.model, lens.parameters[4:]) == (model, distortion)


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ({"file_path": "bad.png"}, "transform_matrix is missing"),
        ({"transform_matrix": MATRIX}, "frame 0.*file_path is missing"),
        ({"file_path": "bad.png", "transform_matrix": [[math.nan] * 4] * 4}, "NaN or infinity"),
        ({"file_path": "bad.png", "transform_matrix": [[1, 2], [3, 4]]}, "shape"),
        ({"file_path": "bad.png", "transform_matrix": np.zeros((4, 4)).tolist()}, "no rotation"),
        ({"file_path": "bad.png", "transform_matrix": np.diag([1, 1, -1, 1]).tolist()}, "no rotation"),
        ({"file_path": "bad.png", "transform_matrix": np.diag([1.1, 1.1, 1.1, 1]).tolist()}, "no rotation"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "fl_x": -3}, "not positive"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "camera_model": "ODD"}, "ODD"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "latlong": True}, "camera_model latlong"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "ftheta_p0": 0.0}, "camera_model ftheta_p0"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "k4": 0.1}, "k4 of 0.1, which OPENCV does not have"),
        (
            {"file_path": "bad.png", "transform_matrix": MATRIX, "camera_model": "PINHOLE", "k1": 0.1},
            "k1 of 0.1, which",
        ),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "camera_model": "RADIAL", "k3": 0.1}, "k3 of 0.1, which"),
        (
            {"file_path": "bad.png", "transform_matrix": MATRIX, "is_fisheye": True, "p1": 9},
            "p1 of 9, which OPENCV_FISH",
        ),
        (
            {
                "file_path": "bad.png",
                "transform_matrix": [[0, 0.8, -0.6, 1.5e308], [0, 0.6, 0.8, -1.5e308], [1, 0, 0, 0]],
            },
            r"a transform_matrix has a translation beyond 1e\+09: 1\.5e\+308, -1\.5e\+308, 0",
        ),
        ({"file_path": "bad.png" + "\x1b" * 3}, r"bad\.png\?\?\? has no usable pose"),
        ({"file_path": "bad.png" * 1000}, r"frame (bad\.png){17}… has no usable pose"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "w": math.inf, "h": 4}, "infinity"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "fl_x": 1.7e308}, r"focal lengths of \(1\.7e\+308"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "fl_x": 5e-324}, "expected 0.001 to 100000 times"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "cx": -1e300}, "a principal point at"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "k1": 1e300}, "distortion by"),
        ({"file_path": "bad.png", "transform_matrix": MATRIX, "w": 10**400, "h": 4}, "too large"),
    ],
)
def test_a_bad_frame_is_named(tmp_path: Path, frame: dict, message: str) -> None:
    path = write(tmp_path, [frame], fl_x=100.0)
    with pytest.raises(UserError, match=message) as raised:
        read_transforms(path, size_of)
    assert "bad.png" in str(raised.value) or "frame 0" in str(raised.value)


def test_frames_without_any_focal_length_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="fl_x or camera_angle_x is missing"):
        read_transforms(write(tmp_path, [{"file_path": "a", "transform_matrix": MATRIX}]), size_of)


def test_instant_ngps_field_of_view_in_degrees(tmp_path: Path) -> None:
    path = write(tmp_path, [{"file_path": "a", "transform_matrix": MATRIX}], x_fov=90, y_fov=60)
    matrix = read_transforms(path, size_of)[0].lens.matrix()
    assert (matrix[0, 0], matrix[1, 1]) == pytest.approx((320, 240 / math.tan(math.radians(30))))


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"frames": 3}', "{", pytest.param("[" * 10**6, id="deep")])
def test_what_is_no_file_of_poses_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(UserError, match=r"transforms\.json"):
        read_transforms(tmp_path / "transforms.json", size_of)


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    path = write(tmp_path, [{"file_path": "a", "transform_matrix": MATRIX}], fl_x=100.0)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(read_transforms(path, size_of)) == 1


def test_what_the_file_says_beside_poses_is_not_read_for_every_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hostile files may have much else in them, and many frames."""
    given: list[set[str]] = []
    lens = transforms._lens

    def read(values: dict[str, object], size: Callable[[], tuple[int, int]]) -> Lens:
        given.append(set(values))
        return lens(values, size)

    monkeypatch.setattr(transforms, "_lens", read)
    other = {f"note {number}": number for number in range(1000)}
    frames = [{"file_path": f"{number:04d}", "transform_matrix": MATRIX} for number in range(3)]
    assert len(read_transforms(write(tmp_path, frames, fl_x=100.0, **other), size_of)) == 3
    assert given == [{"fl_x", "file_path", "transform_matrix"}] * 3
