"""RTWS changes only what Gaussians look like, and tunes a decoder to show black for what has no watermark."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.hide_image import hide_image
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding.rendering import COVER
from stages.hiding.watermark.codec import new_codec
from stages.hiding.watermark.storage import read_codec, write_codec
from stages.imaging.metric_table import read_rows
from stages.imaging.pictures import picture_to_tensor
from stages.scene.gaussians import GEOMETRY
from stages.scene.scene import read_scene
from stages.training.decoder_tuning import CLEAN, OTHERS, PHOTOS, RENDERS, DecoderTuning, TuningSettings
from stages.training.feature_tuning import half_watermarked
from stages.training.views import training_views
from stages.tune_watermark_decoder import TuneWatermarkDecoderParameters, tune_watermark_decoder
from tests.running import run_stage
from tests.stages import small, watermarks
from tests.stages.test_edit_splats import enlarged
from tests.stages.watermarks import Inputs, errors_of, finetuned, inputs_of_rtws


@pytest.fixture
def inputs(tmp_path: Path) -> Inputs:
    return inputs_of_rtws(tmp_path)


def sorted_rows(splats: Artifact, name: str) -> np.ndarray:
    return splats.read(name)[np.lexsort(splats.read("means").T)]


def test_only_colours_change(tmp_path: Path, inputs: Inputs) -> None:
    before = inputs["container"]
    assert isinstance(before, Artifact)
    made = finetuned(tmp_path / "made", inputs)
    container = made["container"]
    assert not container.private
    for name in GEOMETRY:
        np.testing.assert_array_equal(container.read(name), sorted_rows(before, name))
    assert not np.array_equal(container.read("sh_base"), sorted_rows(before, "sh_base"))
    assert not any("/" in name for name in container.names)


def test_gaussians_follow_the_watermarked_views(tmp_path: Path, inputs: Inputs) -> None:
    """A codec that hides nothing leaves all views as they are, so the Gaussians then become others."""
    with create(tmp_path / "codec that hides nothing", "codec") as writer:
        write_codec(writer, new_codec(1, 4, seed=0))
    idle = load(tmp_path / "codec that hides nothing")
    marked, unmarked = (
        finetuned(tmp_path / name, inputs | {"codec": codec})["container"].read("sh_base")
        for name, codec in (("marked", inputs["codec"]), ("unmarked", idle))
    )
    assert not np.array_equal(marked, unmarked)
    control = finetuned(tmp_path / "control", inputs, marked=False)["container"].read("sh_base")
    np.testing.assert_array_equal(control, unmarked)


def test_what_does_not_fit_the_container_is_refused_before_pictures_are_marked(
    tmp_path: Path, inputs: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Marking pictures can take half an hour."""
    monkeypatch.setattr("stages.finetune_rtws.half_watermarked", lambda *_: pytest.fail("marked"))
    views = small.message_views(tmp_path / "views")
    parameters = HideScenesParameters.model_validate({"method": "sh", "iterations": 1, "message_points": 20})
    made = run_stage(hide_scenes, parameters, {"cover": inputs["cover"], "messages": (views,)}, tmp_path / "hidden")
    given = inputs | {"container": made["container"], "messages": (views,)}
    with pytest.raises(UserError, match="the messages cannot be read without the secret"):
        finetuned(tmp_path / "no secret", given, method="sh")
    others = (small.message_views(tmp_path / "others", "vase"),)
    with pytest.raises(UserError, match="hides none of the messages"):
        finetuned(tmp_path / "others' messages", given | {"secret": made["secret"], "messages": others}, method="sh")
    with pytest.raises(UserError, match="attributes"):
        finetuned(tmp_path / "unknown attributes", inputs | {"container": made["container"]}, method="sh")


def test_decoders_and_the_message_stay(tmp_path: Path, inputs: Inputs) -> None:
    settings = {"iterations": 3, "decoder_width": 8, "feature_dim": 8, "layers": 2}
    parameters = hide_image.parameters.model_validate(settings)
    hidden = {"cover": inputs["cover"], "image": inputs["watermark"]}
    made = run_stage(hide_image, parameters, hidden, tmp_path / "hidden")
    given = inputs | {"container": made["container"], "image": inputs["watermark"]}
    with pytest.raises(UserError, match="nothing says which view hides the image; found no secret"):
        finetuned(tmp_path / "refused", given, method="gs_hider")
    after = finetuned(tmp_path / "made", given | {"secret": made["secret"]}, method="gs_hider")
    for name in made["container"].names:
        if name != "raw_features":
            np.testing.assert_array_equal(after["container"].read(name), made["container"].read(name))
    assert "emblem" in {row.message for row in read_rows(after["curves"])}


def test_half_of_the_views_are_watermarked(inputs: Inputs) -> None:
    cover = inputs["cover"]
    assert isinstance(cover, Artifact)
    views = training_views(read_scene(cover))
    watermark = torch.rand(small.HEIGHT, small.WIDTH, 3, generator=torch.Generator().manual_seed(0))
    marked, rows = half_watermarked(views, watermarks.little_codec(), watermark, 0, lambda: None)
    pairs = zip(marked.pictures[COVER], views.pictures[COVER], strict=True)
    assert tuple(row for row, pair in enumerate(pairs) if not torch.equal(*pair)) == rows
    assert len(rows) == len(views.cameras) // 2
    assert rows != half_watermarked(views, watermarks.little_codec(), watermark, 1, lambda: None)[1]


def test_half_of_a_single_view_would_be_none(tmp_path: Path) -> None:
    views = training_views(read_scene(small.scene(tmp_path / "cover", test_views=small.VIEWS - 1)))
    watermark = torch.zeros(small.HEIGHT, small.WIDTH, 3)
    with pytest.raises(UserError, match="found 1 training view; expected two or more"):
        half_watermarked(views, watermarks.little_codec(), watermark, 0, lambda: None)


def test_the_decoder_learns_what_to_hold_back(tmp_path: Path, inputs: Inputs) -> None:
    given = {**inputs, "container": finetuned(tmp_path / "marked", inputs)["container"]}
    settings = {"method": "plain", "iterations": 40, "negatives": "photos_and_clean_renders", "distorted": True}
    parameters = TuneWatermarkDecoderParameters.model_validate(settings)
    with pytest.raises(UserError, match="no clean renders"):
        run_stage(tune_watermark_decoder, parameters, given, tmp_path / "refused")
    before = inputs["container"]
    made = run_stage(tune_watermark_decoder, parameters, given | {"before": before}, tmp_path / "made")
    assert made["codec"].private
    black = [row.value for row in read_rows(made["curves"]) if row.method == "black in photos"]
    assert np.mean(black[-10:]) > np.mean(black[:10]) + 2


def test_the_decoder_does_not_learn_from_splats_of_another_world(
    tmp_path: Path, inputs: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stages.tune_watermark_decoder.train_network", lambda context, tuning: [])
    _, before = enlarged(tmp_path / "enlarged")
    given = {**inputs, "container": small.splats(tmp_path / "marked", "container"), "before": before}
    parameters = TuneWatermarkDecoderParameters(method="plain", negatives="photos_and_clean_renders")
    with pytest.raises(UserError, match="not in the world of the cameras"):
        run_stage(tune_watermark_decoder, parameters, given, tmp_path / "made")


def test_the_decoder_learns_nothing_of_test_views(
    tmp_path: Path, inputs: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    tunings: list[DecoderTuning] = []
    monkeypatch.setattr(
        "stages.tune_watermark_decoder.train_network", lambda context, tuning: tunings.append(tuning) or []
    )
    given = {**inputs, "container": small.splats(tmp_path / "marked", "container"), "before": inputs["container"]}
    settings = {"method": "plain", "negatives": "photos_and_clean_renders"}
    parameters = TuneWatermarkDecoderParameters.model_validate(settings)
    run_stage(tune_watermark_decoder, parameters, given, tmp_path / "made")
    scene, [tuning] = read_scene(cast(Artifact, inputs["cover"])), tunings
    np.testing.assert_array_equal(tuning.pictures[PHOTOS], scene.pictures[scene.rows(scene.train_names)])
    assert {kind: len(pictures) for kind, pictures in tuning.pictures.items()} == dict.fromkeys(
        (RENDERS, PHOTOS, CLEAN), len(scene.train_names)
    )
    assert len(scene.train_names) < len(scene.cameras)


def test_a_decoder_that_sees_whole_pictures_learns_from_other_photos_too(tmp_path: Path, inputs: Inputs) -> None:
    marked = finetuned(tmp_path / "marked", inputs)["container"]
    others = (watermarks.capture(tmp_path / "others", seed=5),)
    given = {**inputs, "container": marked, "before": inputs["container"], "photos": others}
    settings = {"method": "plain", "iterations": 3, "batch": 2, "tinted": True, "whole_pictures": True}
    parameters = TuneWatermarkDecoderParameters.model_validate(settings)
    made = run_stage(tune_watermark_decoder, parameters, given, tmp_path / "made")
    assert {row.method for row in read_rows(made["curves"])} == {RENDERS, PHOTOS, OTHERS}
    assert read_codec(made["codec"]).sees_whole_pictures


def test_a_capture_of_one_photo_is_not_learnt_from(tmp_path: Path, inputs: Inputs) -> None:
    alone = watermarks.stored_capture(tmp_path / "alone", {"alone.png": small.pictures(5)[0]})
    given = {**inputs, "container": small.splats(tmp_path / "marked", "container"), "photos": (alone,)}
    parameters = TuneWatermarkDecoderParameters(method="plain", iterations=3, evenly=True)
    made = run_stage(tune_watermark_decoder, parameters, given, tmp_path / "made")
    assert {row.method for row in read_rows(made["curves"])} == {RENDERS, PHOTOS}


def test_a_batch_goes_through_pictures_as_single_steps_do() -> None:
    """Every picture comes once per pass, for any batch size; a step's error is the mean over its batch."""
    shown = np.stack([np.full((8, 10, 3), level, np.uint8) for level in (10, 60, 120, 200)])
    watermark = np.zeros((8, 10, 3), np.uint8)
    found: dict[int, list[float]] = {}
    for batch in (1, 2):
        settings = TuningSettings(4 // batch, seed=3, batch=batch)
        tuning = DecoderTuning(watermarks.little_codec(), watermark, {RENDERS: shown}, settings)
        steps = range(1, settings.iterations + 1)
        found[batch] = [errors_of(tuning, step)[RENDERS] for step in steps]
    assert len(set(found[1])) == 4
    assert found[2] == pytest.approx([np.mean(found[1][:2]), np.mean(found[1][2:])])


def test_renders_show_the_watermark_and_all_else_is_black() -> None:
    """Before it is tuned, a decoder that expects a watermark shows it for any picture."""
    watermark = np.full((8, 10, 3), 255, np.uint8)
    codec = new_codec(1, 4, seed=0)
    codec.expect(picture_to_tensor(watermark))
    pictures = {kind: np.zeros((1, 8, 10, 3), np.uint8) for kind in (RENDERS, PHOTOS, CLEAN)}
    tuning = DecoderTuning(codec, watermark, pictures, TuningSettings(1, seed=0), [[watermark]])
    errors = errors_of(tuning, 1)
    assert errors == pytest.approx({RENDERS: 0, PHOTOS: 1, CLEAN: 1, OTHERS: 1}, abs=1e-5)


def test_black_counts_by_its_weight_and_renders_by_one() -> None:
    picture = np.zeros((8, 10, 3), np.uint8)
    pictures = dict.fromkeys((RENDERS, PHOTOS, CLEAN), picture[None])
    settings = TuningSettings(1, seed=0, black_weight=0.25)
    tuning = DecoderTuning(watermarks.little_codec(), picture, pictures, settings, [[picture]])
    weighed = {kind: tuning.weighed(kind, torch.tensor(2.0), 1).item() for kind in (*pictures, OTHERS)}
    assert weighed == {RENDERS: 2, PHOTOS: 0.5, CLEAN: 0.5, OTHERS: 0.5}


def test_the_windows_that_a_decoder_sees_most_in_are_learnt() -> None:
    """One of four scenes is not black; among twelve windows, one nearly always shows it."""
    bright = [np.full((8, 10, 3), 255, np.uint8)]
    scenes_of_photos = [bright, *([np.zeros((8, 10, 3), np.uint8)] * 40 for _ in range(3))]
    found = {}
    for hardest_of in (1, 12):
        settings = TuningSettings(20, seed=1, hardest_of=hardest_of)
        watermark = np.zeros((8, 10, 3), np.uint8)
        shown = {RENDERS: np.zeros((1, 8, 10, 3), np.uint8)}
        tuning = DecoderTuning(watermarks.little_codec(), watermark, shown, settings, scenes_of_photos)
        found[hardest_of] = [errors_of(tuning, step)[OTHERS] for step in range(1, 21)]
    assert np.mean(found[12]) > 2 * np.mean(found[1])


def test_renders_between_the_views_are_learnt_from(tmp_path: Path, inputs: Inputs) -> None:
    marked = finetuned(tmp_path / "marked", inputs)["container"]
    given = {**inputs, "container": marked, "before": inputs["container"]}
    made = []
    for between in (0, 3):
        parameters = TuneWatermarkDecoderParameters.model_validate(
            {"method": "plain", "iterations": 3, "between": between}
        )
        made.append(run_stage(tune_watermark_decoder, parameters, given, tmp_path / f"made {between}")["codec"].digest)
    assert len(set(made)) == 2
