"""Photos of packages are known by their bytes, when they are installed and when they are read."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
import yaml

from pipeline.errors import UserError
from stages.imaging import shipped_photos
from stages.imaging.pictures import encode_png
from stages.imaging.shipped_photos import install_photos, installed_photos, main, photo_file, read_photo

WORKFLOWS = Path(__file__).parents[3] / "workflows"
PICTURE = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
CONTENT = encode_png(PICTURE)


@pytest.fixture
def unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package that ships a photo, and another of the same name; nothing is installed yet."""
    monkeypatch.setenv("GS_HIDER_DATA", str(tmp_path / "data"))
    for digests in ("DIGESTS", "SAMPLES", "WALLPAPERS", "EXAMPLES"):
        monkeypatch.setattr(shipped_photos, digests, {"cat.png": hashlib.sha256(CONTENT).hexdigest()})
    for folder, content in (("a", b"another cat"), ("b", CONTENT)):
        (tmp_path / "unpacked" / folder).mkdir(parents=True)
        (tmp_path / "unpacked" / folder / "cat.png").write_bytes(content)
    return tmp_path / "unpacked"


def test_the_photo_of_these_bytes_is_installed(unpacked: Path) -> None:
    assert installed_photos() == ()
    assert install_photos(unpacked, shipped_photos.SAMPLES) == [photo_file("cat.png")]
    assert installed_photos() == ("cat.png",)
    np.testing.assert_array_equal(read_photo("cat.png"), PICTURE)


def test_a_large_photo_is_reduced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = encode_png(np.zeros((10, 1600, 3), np.uint8))
    monkeypatch.setenv("GS_HIDER_DATA", str(tmp_path))
    for digests in ("DIGESTS", "WALLPAPERS"):
        monkeypatch.setattr(shipped_photos, digests, {"wide.png": hashlib.sha256(content).hexdigest()})
    (tmp_path / "wide.png").write_bytes(content)
    assert main([str(tmp_path), "--wallpapers"]) == 0
    assert read_photo("wide.png").shape == (5, 800, 3)


def test_the_workflow_tries_imprints_on_all_that_is_held_out() -> None:
    workflow = yaml.safe_load((WORKFLOWS / "rtws.yaml").read_text())
    assert tuple(workflow["vars"]["held_out_photos"]) == shipped_photos.HELD_OUT
    assert {*workflow["vars"]["settling_photos"]} == {*shipped_photos.DIGESTS} - {*shipped_photos.HELD_OUT}
    assert {*workflow["vars"]["learnt_photos"]} < {*workflow["vars"]["settling_photos"]}
    assert {*shipped_photos.HELD_OUT} < {*shipped_photos.DIGESTS}


def test_another_picture_of_its_name_is_refused(unpacked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (unpacked / "b" / "cat.png").unlink()
    assert main([str(unpacked)]) == 1
    assert "scikit-image" in capsys.readouterr().err
    with pytest.raises(UserError, match="cannot be read"):
        read_photo("cat.png")
    photo_file("cat.png").parent.mkdir(exist_ok=True)
    photo_file("cat.png").write_bytes(b"another cat")
    with pytest.raises(UserError, match="not the photo"):
        read_photo("cat.png")
