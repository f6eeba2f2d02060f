"""Photos that packages ship are known by their bytes, when they are installed and when they are read."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from pipeline.errors import UserError
from pipeline.stage import Parameters
from stages.imaging import shipped_photos
from stages.imaging.photo_digests import DIGESTS, EXAMPLES, HELD_OUT, PLACES, SAMPLES, WALLPAPERS
from stages.imaging.pictures import encode_png
from stages.imaging.shipped_photos import SETS, ShippedPhotos, installed_photos, main, photo_file, read_photo

PICTURE = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
CONTENT = encode_png(PICTURE)


@pytest.fixture
def unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package with a known photo and another file of the same name; nothing is installed yet."""
    monkeypatch.setenv("GS_HIDER_DATA", str(tmp_path / "data"))
    monkeypatch.setattr(shipped_photos, "DIGESTS", {"cat.png": _sha256(CONTENT), "dog.png": _sha256(b"a dog")})
    for folder, content in (("a", b"another cat"), ("b", CONTENT)):
        (tmp_path / "unpacked" / folder).mkdir(parents=True)
        (tmp_path / "unpacked" / folder / "cat.png").write_bytes(content)
    return tmp_path / "unpacked"


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def test_the_photo_of_these_bytes_is_installed(unpacked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert installed_photos() == ()
    assert main([str(unpacked)]) == 0
    assert capsys.readouterr().out.split() == [str(photo_file("cat.png"))]
    assert installed_photos() == ("cat.png",)
    np.testing.assert_array_equal(read_photo("cat.png"), PICTURE)


def test_it_says_which_photos_are_missing(unpacked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(unpacked)]) == 0
    assert "dog.png" in capsys.readouterr().err


def test_a_large_photo_is_reduced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = encode_png(np.zeros((10, 1600, 3), np.uint8))
    monkeypatch.setenv("GS_HIDER_DATA", str(tmp_path))
    monkeypatch.setattr(shipped_photos, "DIGESTS", {"wide.png": _sha256(content)})
    (tmp_path / "wide.png").write_bytes(content)
    assert main([str(tmp_path)]) == 0
    assert read_photo("wide.png").shape == (5, 800, 3)


def test_no_photo_is_both_learnt_from_and_held_out() -> None:
    assert {*HELD_OUT} < {*DIGESTS}
    assert sorted((*SETS["learnt_from"], *SETS["held_out"])) == sorted(DIGESTS)
    assert len(DIGESTS) == sum(map(len, (SAMPLES, WALLPAPERS, EXAMPLES, PLACES)))
    assert len({*DIGESTS.values()}) == len(DIGESTS), "one photo has two names"


def test_names_are_one_where_case_does_not_count() -> None:
    assert len({name.lower() for name in DIGESTS}) == len(DIGESTS)


def test_a_set_stands_for_those_of_it_that_are_installed(unpacked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shipped_photos, "SETS", {"held_out": ("dog.png", "cat.png")})
    parameter = TypeAdapter(ShippedPhotos, config=Parameters.model_config)
    assert parameter.validate_json('"held_out"') == ()
    main([str(unpacked)])
    assert parameter.validate_json('"held_out"') == ("cat.png",)
    assert parameter.validate_json('["cat.png", "dog.png"]') == ("cat.png",)
    with pytest.raises(ValidationError, match="there is no set of photos 'held_in'"):
        parameter.validate_json('"held_in"')
    with pytest.raises(ValidationError, match="no package ships cta"):
        parameter.validate_json('["cat.png", "cta.png"]')


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
