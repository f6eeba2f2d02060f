"""Videos along the cover's cameras: all for the owner, only the cover for the public."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.analysis.videos import Video, read_videos
from stages.hiding.method import build_method
from stages.hiding.rendering import COVER
from stages.hiding.storage import write_container, write_secret
from stages.imaging import video
from stages.render_path import RenderPathParameters, render_path
from stages.scene.gaussians import gaussians_at
from tests.running import run_stage
from tests.stages import small

MESSAGES = ["Zebraquartz", "statue"]
SMALL = RenderPathParameters(method="gs_hider", frames=6, seconds=0.5)


def hidden(folder: Path, image_view: str | None = None) -> dict[str, Artifact | tuple[Artifact, ...]]:
    torch.manual_seed(0)
    settings = {"feature_dim": 8, "layers": 2, "decoder_width": 8, "precision": "float32", "messages": MESSAGES}
    method = build_method("gs_hider", settings)
    colors = {name: np.full((60, 3), 0.3 + 0.2 * number) for number, name in enumerate((COVER, *MESSAGES))}
    attributes = method.initial_attributes(colors, np.random.default_rng(0))
    with create(folder / "container", "container") as writer:
        write_container(writer, gaussians_at(small.points(), attributes), method)
    with create(folder / "secret", "secret", private=True) as writer:
        write_secret(writer, method, MESSAGES, image_view)
    return {
        "container": load(folder / "container"),
        "secret": load(folder / "secret"),
        "cover": small.scene(folder / "cover"),
    }


def filmed(made: dict[str, Artifact], name: str = "videos") -> dict[str, Video]:
    return {video.title: video for video in read_videos(made[name])}


def test_the_owner_gets_everything_and_the_public_the_cover(tmp_path: Path) -> None:
    made = run_stage(render_path, SMALL, hidden(tmp_path), tmp_path / "out")
    videos = filmed(made)
    assert {title: video.role for title, video in videos.items()} == {
        "cover": "cover",
        "Zebraquartz": "message",
        "statue": "message",
        "feature map": "feature_map",
        "side by side": "side_by_side",
    }
    together = videos["side by side"]
    assert together.panels == ("cover", "Zebraquartz", "statue", "feature map")
    assert (together.columns, together.width, together.height) == (4, 4 * 2 * small.WIDTH, 2 * small.HEIGHT)
    assert made["videos"].private
    assert not made["public_videos"].private
    assert filmed(made, "public_videos") == {"cover": videos["cover"]}
    published = b"".join(path.read_bytes() for path in made["public_videos"].path.rglob("*") if path.is_file())
    assert not [name for name in (*MESSAGES, "feature", "message") if name.encode() in published]


def test_without_the_secret_there_are_no_messages_and_the_same_cover(tmp_path: Path) -> None:
    inputs = hidden(tmp_path)
    owner = run_stage(render_path, SMALL, inputs, tmp_path / "owner")
    del inputs["secret"]
    anyone = run_stage(render_path, SMALL, inputs, tmp_path / "anyone")
    assert set(filmed(anyone)) == {"cover", "feature map", "side by side"}
    assert filmed(anyone)["cover"] == filmed(owner)["cover"]
    assert anyone["public_videos"].digest == owner["public_videos"].digest


def test_a_hidden_image_is_not_filmed_from_where_nothing_of_it_is_seen(tmp_path: Path) -> None:
    made = run_stage(render_path, SMALL, hidden(tmp_path, small.NAMES[3]), tmp_path / "out")
    assert set(filmed(made)) == {"cover", "feature map", "side by side"}


def test_the_same_inputs_give_the_same_bytes(tmp_path: Path) -> None:
    inputs = hidden(tmp_path)
    once, again = (run_stage(render_path, SMALL, inputs, tmp_path / name) for name in ("once", "again"))
    assert once["videos"].digest == again["videos"].digest


def test_a_plain_scene_has_one_video(tmp_path: Path) -> None:
    inputs = {"container": small.splats(tmp_path / "splats", "container"), "cover": small.scene(tmp_path / "cover")}
    parameters = RenderPathParameters(method="plain", frames=4)
    assert set(filmed(run_stage(render_path, parameters, inputs, tmp_path / "out"))) == {"cover"}


def test_pictures_come_in_order_and_side_by_side_in_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Judged by what the encoder is given: each panel of the side-by-side video is the separate video."""
    given: list[list[np.ndarray]] = []
    encode = video.encode_animation
    monkeypatch.setattr(video, "encode_animation", lambda pictures: given.append(list(pictures)) or encode(pictures))
    run_stage(render_path, SMALL, hidden(tmp_path), tmp_path / "out")
    *each, together = given
    assert [len(pictures) for pictures in given] == [6] * 5
    for number, pictures in enumerate(each):
        left = 2 * small.WIDTH * number
        for picture, wide in zip(pictures, together, strict=True):
            np.testing.assert_array_equal(wide[:, left : left + 2 * small.WIDTH], picture)
    assert not np.array_equal(each[0][0], each[0][3]), "the camera moves"
    with Image.open(io.BytesIO(encode(together))) as animation:
        assert animation.n_frames == 6


def test_another_method_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="another method"):
        run_stage(render_path, RenderPathParameters(method="plain"), hidden(tmp_path), tmp_path / "out")
