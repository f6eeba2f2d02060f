"""Photos that EXIF turns: upright as they are seen, or as stored if the poses that came with them are of that."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from stages.imaging.pictures import read_picture
from stages.scene.capture import picture_path, read_capture
from tests.stages.scene.test_colmap import write_binary_model
from tests.stages.test_photos import capture, expect_refusal, take


def test_a_turned_photo_counts_as_it_is_seen(tmp_path: Path) -> None:
    take(tmp_path / "photos" / "a.jpg", size=(64, 48), orientation=6, focal=36)
    artifact = capture(tmp_path / "photos", tmp_path / "out")
    found = read_capture(artifact)
    assert found.sizes == ((48, 64),)
    assert read_picture(picture_path(artifact, "a.jpg")).shape == (64, 48, 3)
    diagonal_of_film = np.hypot(36, 24)
    assert found.focal_pixels[0] == pytest.approx(36 * np.hypot(48, 64) / diagonal_of_film)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("background", ["white", "black"])
def test_photos_whose_poses_came_with_them_lie_as_their_pixels_are_stored(
    tmp_path: Path, orientation: int, background: str
) -> None:
    generator, exif = np.random.default_rng(0), Image.Exif()
    exif[0x0112] = orientation
    for name, channels in (("a.png", 3), ("b two.png", 4)):
        stored = generator.integers(0, 256, (24, 32, channels), dtype=np.uint8)
        (tmp_path / "scan").mkdir(exist_ok=True)
        Image.fromarray(stored).save(tmp_path / "scan" / name, exif=exif)
    plain = {name: Image.open(tmp_path / "scan" / name) for name in ("a.png", "b two.png")}
    write_binary_model(tmp_path / "scan")  # for pictures wider than high
    log: list[str] = []
    artifact = capture(tmp_path / "scan", tmp_path / "out", log, background=background)
    found = read_capture(artifact)
    assert found.sizes == ((32, 24), (32, 24))
    for name, image in plain.items():
        image.load()
        under = Image.new("RGBA", image.size, background)
        expected = np.array(Image.alpha_composite(under, image.convert("RGBA")).convert("RGB"))
        np.testing.assert_array_equal(read_picture(picture_path(artifact, name)), expected)
    assert any("2 photos are kept as stored" in line for line in log) == (orientation != 1)


@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
def test_photos_that_were_posed_upright_lie_upright(tmp_path: Path, orientation: int) -> None:
    """Programs of the DUSt3R family turn photos by EXIF, and write a COLMAP model for what they see."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    (tmp_path / "scan").mkdir()
    for name in ("a.png", "b two.png"):
        stored = np.random.default_rng(0).integers(0, 256, (32, 24, 3), dtype=np.uint8)
        Image.fromarray(stored).save(tmp_path / "scan" / name, exif=exif)
    write_binary_model(tmp_path / "scan")  # for pictures wider than high
    log: list[str] = []
    artifact = capture(tmp_path / "scan", tmp_path / "out", log)
    found = read_capture(artifact)
    assert found.sizes == ((32, 24), (32, 24))
    assert found.poses is not None
    assert [(lens.width, lens.height) for lens in found.poses.lenses] == [(32, 24), (32, 24)]
    kept = read_picture(picture_path(artifact, "a.png"))
    np.testing.assert_array_equal(kept, read_picture(tmp_path / "scan" / "a.png"))
    assert kept.shape == (24, 32, 3)
    assert not any("kept as stored" in line for line in log)


def test_photos_that_do_not_fit_their_poses_even_turned_are_refused(tmp_path: Path) -> None:
    take(tmp_path / "scan" / "a.jpg", size=(100, 50), orientation=6)
    take(tmp_path / "scan" / "b two.jpg", size=(100, 50), orientation=6)
    write_binary_model(tmp_path / "scan")
    expect_refusal(tmp_path / "scan", tmp_path / "out", "of another shape")
