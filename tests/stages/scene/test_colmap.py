from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.errors import UserError
from stages.scene.colmap import find_colmap_model, models_beside, photos_in_model, read_colmap_model
from stages.scene.lens import Lens

LENS = Lens("OPENCV", (500.0, 510.0, 320.0, 240.0, -0.1, 0.02, 0.001, 0.002), 640, 480)
QUATERNION, TRANSLATION = (0.5, 0.5, -0.5, 0.5), (1.0, 2.0, 3.0)


def write_text_model(folder: Path, pose: tuple[float, ...] = (*QUATERNION, *TRANSLATION)) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    numbers = " ".join(map(str, LENS.parameters))
    (folder / "cameras.txt").write_text(f"# cameras\n7 OPENCV 640 480 {numbers}\n")
    written = " ".join(map(str, pose))
    (folder / "images.txt").write_text(f"# images\n1 {written} 7 b two.jpg\n1.0 2.0 -1\n2 {written} 7 a.jpg\n\n")


def write_binary_model(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.bin").write_bytes(struct.pack("<QiiQQ8d", 1, 7, 4, 640, 480, *LENS.parameters))
    images = struct.pack("<Q", 2)
    for number, name, observations in ((1, b"b two.jpg\0", 0), (2, b"a.jpg\0", 2)):
        images += struct.pack("<I7dI", number, *QUATERNION, *TRANSLATION, 7) + name
        images += struct.pack("<Q", observations) + struct.pack("<ddq", 1.0, 2.0, -1) * observations
    (folder / "images.bin").write_bytes(images)


@pytest.mark.parametrize("write", [write_text_model, write_binary_model])
def test_both_forms_read_the_same(tmp_path: Path, write) -> None:
    write(tmp_path)
    first, second = read_colmap_model(tmp_path)
    assert (first.name, second.name) == ("a.jpg", "b two.jpg")
    assert first.lens == LENS
    w, *xyz = QUATERNION
    np.testing.assert_allclose(second.world_to_camera[:3, :3], Rotation.from_quat([*xyz, w]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(second.world_to_camera[:, 3], [*TRANSLATION, 1])


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "colmap/sparse/0", "."])
def test_a_model_is_found_where_captures_keep_it(tmp_path: Path, place: str) -> None:
    assert find_colmap_model(tmp_path) is None
    write_text_model(tmp_path / place)
    found = find_colmap_model(tmp_path)
    assert found is not None
    assert len(read_colmap_model(found)) == 2


def test_of_several_models_the_one_of_most_photos_counts(tmp_path: Path) -> None:
    """COLMAP writes a model for each part that it could not connect; the largest may have any number."""
    for number, photos in (("0", 1), ("1", 2), ("2", 2), ("10", 1)):
        write_text_model(tmp_path / "sparse" / number)
        if photos == 1:
            images = tmp_path / "sparse" / number / "images.txt"
            images.write_text("\n".join(images.read_text().splitlines()[:3]))
    (tmp_path / "sparse" / "notes").mkdir()
    write_binary_model(tmp_path / "sparse" / "3")
    (tmp_path / "sparse" / "3" / "images.bin").write_bytes(b"cut off")
    found = find_colmap_model(tmp_path)
    assert found == tmp_path / "sparse" / "1"
    others = [(other.name, photos_in_model(other)) for other in models_beside(found)]
    assert others == [("0", 1), ("2", 2), ("3", 0), ("10", 1)]
    (found / "images.txt").write_text("no model")
    assert find_colmap_model(tmp_path) == tmp_path / "sparse" / "2"


def test_half_a_model_is_none(tmp_path: Path) -> None:
    write_text_model(tmp_path / "sparse")
    (tmp_path / "sparse" / "images.txt").unlink()
    assert find_colmap_model(tmp_path) is None


@pytest.mark.parametrize("kept", [4, 30, 100, -1])
@pytest.mark.parametrize("part", ["cameras.bin", "images.bin"])
def test_a_shortened_model_is_refused_by_name(tmp_path: Path, part: str, kept: int) -> None:
    write_binary_model(tmp_path)
    whole = (tmp_path / part).read_bytes()
    (tmp_path / part).write_bytes(whole[: min(kept, len(whole) - 1) if kept > 0 else kept])
    with pytest.raises(UserError, match=part):
        read_colmap_model(tmp_path)


def test_poses_that_are_not_finite_are_refused_with_the_photo(tmp_path: Path) -> None:
    write_text_model(tmp_path, (*QUATERNION, np.nan, 0.0, 0.0))
    with pytest.raises(UserError, match=r"images\.txt.*b two\.jpg.*not finite"):
        read_colmap_model(tmp_path)


@pytest.mark.parametrize("length", [1e-200, 1e200, 1e308, 5e-324])
def test_quaternions_of_any_length_are_the_same_rotation(tmp_path: Path, length: float) -> None:
    quaternion = tuple(float(np.sign(value)) * length for value in QUATERNION)
    write_text_model(tmp_path, (*quaternion, *TRANSLATION))
    w, *xyz = QUATERNION
    expected = Rotation.from_quat([*xyz, w]).as_matrix()
    for photo in read_colmap_model(tmp_path):
        np.testing.assert_allclose(photo.world_to_camera[:3, :3], expected, atol=1e-12)


@pytest.mark.parametrize("far", [1e308, -2e9])
def test_translations_that_no_scene_has_are_refused_with_the_photo(tmp_path: Path, far: float) -> None:
    write_text_model(tmp_path, (*QUATERNION, 0.0, far, 0.0))
    with pytest.raises(UserError, match=r"images\.txt.*b two\.jpg has a translation beyond 1e\+09: 0, -?[12]e"):
        read_colmap_model(tmp_path)


def test_an_unknown_lens_is_named(tmp_path: Path) -> None:
    write_text_model(tmp_path)
    (tmp_path / "cameras.txt").write_text("7 EQUIRECTANGULAR 640 480 640 480\n")
    with pytest.raises(UserError, match="EQUIRECTANGULAR"):
        read_colmap_model(tmp_path)


def test_a_side_of_more_digits_than_a_float_has_is_refused_with_its_line(tmp_path: Path) -> None:
    write_text_model(tmp_path)
    (tmp_path / "cameras.txt").write_text(f"7 PINHOLE {'1' * 400} 480 50 50 32 24\n")
    with pytest.raises(UserError, match=r"cameras\.txt.*a side of more than 1,000,000 pixels"):
        read_colmap_model(tmp_path)


def test_text_is_read_as_colmap_reads_it(tmp_path: Path) -> None:
    write_text_model(tmp_path)
    for part in ("cameras.txt", "images.txt"):
        whole = (tmp_path / part).read_text()
        (tmp_path / part).write_text("\ufeff\n  # indented\n" + whole.replace("b two.jpg\n1.0", "b two.jpg \r\n 1.0"))
    assert [photo.name for photo in read_colmap_model(tmp_path)] == ["a.jpg", "b two.jpg"]


@pytest.mark.parametrize("name", ["a.jpg", "a b.jpg", "a b c.jpg", "7"])
def test_images_without_lines_of_observations_are_refused_not_halved(tmp_path: Path, name: str) -> None:
    write_text_model(tmp_path)
    lines = [line for line in (tmp_path / "images.txt").read_text().splitlines() if "jpg" in line]
    (tmp_path / "images.txt").write_text("\n".join(lines).replace("a.jpg", name))
    with pytest.raises(UserError, match=r"images\.txt.*line 2: the line of observations after an image is missing"):
        read_colmap_model(tmp_path)


def test_image_ids_are_those_that_a_binary_model_can_hold(tmp_path: Path) -> None:
    write_text_model(tmp_path)
    images = (tmp_path / "images.txt").read_text()
    (tmp_path / "images.txt").write_text(images.replace("\n2 ", f"\n{2**32 - 1} "))
    assert [photo.number for photo in read_colmap_model(tmp_path)] == [2**32 - 1, 1]
    for number in (-1, 2**32):
        (tmp_path / "images.txt").write_text(images.replace("\n2 ", f"\n{number} "))
        with pytest.raises(UserError, match=rf"line 4: a photo of number {number}\b"):
            read_colmap_model(tmp_path)


@pytest.mark.parametrize("missing", range(1, 9))
def test_an_image_that_lacks_a_number_is_refused_with_its_line(tmp_path: Path, missing: int) -> None:
    write_text_model(tmp_path)
    (tmp_path / "images.txt").write_text(" ".join(["1"] * (9 - missing) + ["a.jpg"]) + "\n\n")
    with pytest.raises(UserError, match=r"line 1: .* of the 10 parts"):
        read_colmap_model(tmp_path)


def test_a_photo_of_a_camera_that_is_missing_is_named(tmp_path: Path) -> None:
    write_text_model(tmp_path)
    (tmp_path / "cameras.txt").write_text((tmp_path / "cameras.txt").read_text().replace("\n7 ", "\n8 "))
    with pytest.raises(UserError, match=r"b two\.jpg was taken by camera 7"):
        read_colmap_model(tmp_path)


def test_a_camera_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    write_text_model(tmp_path / "text")
    cameras = tmp_path / "text" / "cameras.txt"
    cameras.write_text(cameras.read_text() + "7 PINHOLE 640 480 400 400 320 240\n")
    with pytest.raises(UserError, match=r"cameras\.txt.*line 3: camera 7 is listed twice"):
        read_colmap_model(tmp_path / "text")
    write_binary_model(tmp_path / "binary")
    cameras = tmp_path / "binary" / "cameras.bin"
    cameras.write_bytes(struct.pack("<Q", 2) + 2 * cameras.read_bytes()[8:])
    with pytest.raises(UserError, match=r"cameras\.bin.*camera 7 is listed twice"):
        read_colmap_model(tmp_path / "binary")


def test_half_a_binary_model_beside_a_whole_one_of_text_is_not_read(tmp_path: Path) -> None:
    write_text_model(tmp_path)
    (tmp_path / "cameras.bin").write_bytes(b"")
    assert find_colmap_model(tmp_path) == tmp_path
    assert len(read_colmap_model(tmp_path)) == 2


def test_a_folder_without_a_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="without a COLMAP model"):
        read_colmap_model(tmp_path)
