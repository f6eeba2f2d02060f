"""Photos of packages are known by their bytes, when they are installed and when they are read."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import UserError
from stages.imaging import shipped_photos
from stages.imaging.pictures import encode_png
from stages.imaging.shipped_photos import install_photos, installed_photos, main, photo_file, read_photo

PICTURE = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
CONTENT = encode_png(PICTURE)


@pytest.fixture
def unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package that ships a photo, and another of the same name; nothing is installed yet."""
    monkeypatch.setenv("GS_HIDER_DATA", str(tmp_path / "data"))
    monkeypatch.setattr(shipped_photos, "DIGESTS", {"cat.png": hashlib.sha256(CONTENT).hexdigest()})
    for folder, content in (("a", b"another cat"), ("b", CONTENT)):
        (tmp_path / "unpacked" / folder).mkdir(parents=True)
        (tmp_path / "unpacked" / folder / "cat.png").write_bytes(content)
    return tmp_path / "unpacked"


def test_the_photo_of_these_bytes_is_installed(unpacked: Path) -> None:
    assert installed_photos() == ()
    assert install_photos(unpacked) == [photo_file("cat.png")]
    assert installed_photos() == ("cat.png",)
    np.testing.assert_array_equal(read_photo("cat.png"), PICTURE)


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
