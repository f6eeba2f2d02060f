"""Videos show nearly what was given, and are the same bytes every time."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, features

from pipeline.errors import UserError
from stages.imaging.iso_media import coded_pictures
from stages.imaging.pictures import Picture, picture_to_tensor
from stages.imaging.psnr import psnr
from stages.imaging.video import doubled, encode_animation, encode_video
from stages.imaging.webm import write_webm

WIDTH, HEIGHT = 96, 64


def moving(count: int, width: int = WIDTH, height: int = HEIGHT) -> list[Picture]:
    """A coloured pattern of waves a few pixels long that drifts, with noise."""
    noise = np.random.default_rng(0).uniform(0, 24, (height, width + count, 3))
    x, y = np.meshgrid(np.arange(width + count), np.arange(height))
    waves = np.stack([np.sin(x / 3), np.sin(y / 4 + x / 9), np.sin((x - y) / 5)], axis=-1)
    picture = (116 + 100 * waves + noise).astype(np.uint8)
    return [picture[:, start : start + width] for start in range(count)]


def packets(webm: bytes, folder: Path) -> tuple[cv2.VideoCapture, list[bytes]]:
    """The file as another program's reader opens it, and the coded pictures that this reader finds."""
    (folder / "video.webm").write_bytes(webm)
    capture = cv2.VideoCapture(str(folder / "video.webm"), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    assert capture.isOpened()
    found = []
    while (read := capture.read())[0]:
        found.append(read[1].tobytes())
    return capture, found


def test_decoded_pictures_are_faithful() -> None:
    pictures = [doubled(picture) for picture in moving(8)]
    with Image.open(io.BytesIO(encode_animation(pictures))) as animation:
        for number, picture in enumerate(pictures):
            animation.seek(number)
            decoded = np.asarray(animation.convert("RGB"))
            small = cv2.resize(decoded, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
            assert psnr(picture_to_tensor(small), picture_to_tensor(picture[::2, ::2])) > 36


def test_another_reader_finds_every_picture(tmp_path: Path) -> None:
    pictures = moving(7)
    capture, found = packets(encode_video(pictures, 12.5), tmp_path)
    assert found == coded_pictures(encode_animation(pictures))[1]
    assert not [picture for picture in found if picture.startswith(b"\x12\x00")], "marks that WebM forbids"
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(12.5)
    assert int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").lower() == b"av01"
    assert (capture.get(cv2.CAP_PROP_FRAME_WIDTH), capture.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (WIDTH, HEIGHT)


def test_long_videos_have_several_clusters(tmp_path: Path) -> None:
    configuration, coded = coded_pictures(encode_animation(moving(9)))
    webm = write_webm(configuration, coded, (WIDTH, HEIGHT), 0.1)
    capture, found = packets(webm, tmp_path)
    assert found == coded
    assert webm.count(b"\x1f\x43\xb6\x75") == 3
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 9


def test_the_same_pictures_give_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    once = encode_video(moving(5), 12)
    monkeypatch.setattr(time, "time", lambda: 1e9)
    assert encode_video(moving(5), 12) == once
    assert b"hid" not in once.lower(), "a published video does not say what made it"


def test_small_pictures_are_doubled_exactly() -> None:
    picture = moving(1)[0]
    double = doubled(picture)
    np.testing.assert_array_equal(double[::2, ::2], picture)
    np.testing.assert_array_equal(double[1::2, 1::2], picture)
    large = np.zeros((4, 1600, 3), np.uint8)
    assert doubled(large).shape == large.shape


@pytest.mark.parametrize(
    ("pictures", "rate"),
    [([], 12), (moving(1), 12), ([*moving(1), *moving(1, width=48)], 12), (moving(3, width=95), 12), (moving(3), 0)],
    ids=["none", "one", "different sizes", "odd", "no speed"],
)
def test_what_is_no_video_is_refused(pictures: list[Picture], rate: float) -> None:
    with pytest.raises(ValueError, match="a video of"):
        encode_video(pictures, rate)


def test_without_an_encoder_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(features, "check", lambda name: False)
    with pytest.raises(UserError, match=r"pillow>=11\.3"):
        encode_video(moving(2), 12)


@pytest.mark.parametrize("damage", [b"", b"\x00\x00\x00\x04free", b"\x00\x00\x00\x08moov"])
def test_other_files_are_refused(damage: bytes) -> None:
    with pytest.raises(ValueError, match="box"):
        coded_pictures(damage)
