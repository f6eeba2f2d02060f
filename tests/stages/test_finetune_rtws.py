"""RTWS changes what Gaussians look like and nothing else, tunes a decoder, and counts where that one is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact
from pipeline.errors import Interrupted, UserError
from pipeline.stage import run_stage
from stages.add_grain import AddGrainParameters, add_grain
from stages.analysis.measurements import read_measurements
from stages.analysis.watermark_trials import (
    CLEAN_CHANNEL,
    DETECTED,
    FALSE_POSITIVES,
    NOISE,
    OTHER_SCENES,
    OWN_SCENE,
    PRUNING,
    PSNR_WATERMARK,
    QUANTISATION,
    SCENES,
    THRESHOLD,
    TRIALS,
    Detector,
    Positives,
    trial_rows,
)
from stages.analysis.watermark_trials import RENDERS as PICTURES_WITH_IT
from stages.detect_watermark import (
    NOISY_PHOTOS,
    OTHER_PHOTOS,
    DetectWatermarkParameters,
    _test_photos,
    detect_watermark,
)
from stages.draw_key import DrawKeyParameters, draw_key
from stages.finetune_rtws import FinetuneRtwsParameters, finetune_rtws
from stages.hide_image import hide_image
from stages.hiding.rendering import COVER
from stages.hiding.watermark.reading import FOUND_SHARE
from stages.hiding.watermark.storage import read_codec
from stages.imaging.metric_table import read_rows
from stages.scene.gaussians import GEOMETRY
from stages.scene.scene import read_scene
from stages.training.decoder_tuning import OTHERS, PHOTOS, RENDERS, DecoderTuning, TuningSettings
from stages.training.feature_tuning import half_watermarked
from stages.training.views import training_views
from stages.tune_watermark_decoder import TuneWatermarkDecoderParameters, tune_watermark_decoder
from tests.stages import small, watermarks
from tests.stages.hiding.relocalisation import scenes
from tests.stages.test_stopping import Asking

Inputs = dict[str, Artifact | tuple[Artifact, ...]]


@pytest.fixture
def inputs(tmp_path: Path) -> Inputs:
    return {
        "container": small.splats(tmp_path / "splats"),
        "cover": small.scene(tmp_path / "scene"),
        "codec": watermarks.codec(tmp_path / "codec"),
        "watermark": watermarks.emblem(tmp_path / "emblem"),
    }


def finetuned(folder: Path, inputs: Inputs, **settings: object) -> dict[str, Artifact]:
    parameters = FinetuneRtwsParameters.model_validate({"method": "plain", "iterations": 6} | settings)
    return run_stage(finetune_rtws, parameters, inputs, folder)


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
    marked, rows = half_watermarked(views, watermarks.little_codec(), watermark, seed=0)
    changed = (marked.pictures[COVER] != views.pictures[COVER]).flatten(1).any(dim=1).nonzero().flatten()
    assert tuple(changed.tolist()) == rows
    assert len(rows) == len(views.cameras) // 2
    assert rows != half_watermarked(views, watermarks.little_codec(), watermark, seed=1)[1]


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


def test_a_decoder_that_sees_whole_pictures_learns_from_other_photos_too(tmp_path: Path, inputs: Inputs) -> None:
    marked = finetuned(tmp_path / "marked", inputs)["container"]
    others = (watermarks.capture(tmp_path / "others", seed=5),)
    given = {**inputs, "container": marked, "before": inputs["container"], "photos": others}
    settings = {"method": "plain", "iterations": 3, "batch": 2, "tinted": True, "whole_pictures": True}
    parameters = TuneWatermarkDecoderParameters.model_validate(settings)
    made = run_stage(tune_watermark_decoder, parameters, given, tmp_path / "made")
    assert {row.method for row in read_rows(made["curves"])} == {RENDERS, PHOTOS, OTHERS}
    assert read_codec(made["codec"]).sees_whole_pictures


def test_a_batch_goes_through_pictures_as_single_steps_do() -> None:
    """Every picture comes once a lap, whatever the batch; each step's error is the mean over its batch."""
    shown = np.stack([np.full((8, 10, 3), level, np.uint8) for level in (10, 60, 120, 200)])
    watermark = np.zeros((8, 10, 3), np.uint8)
    found: dict[int, list[float]] = {}
    for batch in (1, 2):
        settings = TuningSettings(4 // batch, seed=3, batch=batch)
        tuning = DecoderTuning(watermarks.little_codec(), watermark, {RENDERS: shown}, settings)
        steps = range(1, settings.iterations + 1)
        found[batch] = [tuning.errors(step)[RENDERS].item() for step in steps]
    assert len(set(found[1])) == 4
    assert found[2] == pytest.approx([np.mean(found[1][:2]), np.mean(found[1][2:])])


def test_the_windows_that_a_decoder_sees_most_in_are_learnt() -> None:
    """Of four scenes there is one in which it sees more than in black ones: one of twelve windows shows that one."""
    bright = [np.full((8, 10, 3), 255, np.uint8)]
    scenes_of_photos = [bright, *([np.zeros((8, 10, 3), np.uint8)] * 40 for _ in range(3))]
    found = {}
    for hardest_of in (1, 12):
        settings = TuningSettings(20, seed=1, hardest_of=hardest_of)
        watermark = np.zeros((8, 10, 3), np.uint8)
        shown = {RENDERS: np.zeros((1, 8, 10, 3), np.uint8)}
        tuning = DecoderTuning(watermarks.little_codec(), watermark, shown, settings, scenes_of_photos)
        found[hardest_of] = [tuning.errors(step)[OTHERS].item() for step in range(1, 21)]
    assert np.mean(found[12]) > 2 * np.mean(found[1])


def test_grain_is_found_by_its_owner_alone(tmp_path: Path) -> None:
    gaussians, method = scenes.cloud()
    before = watermarks.stored_splats(tmp_path / "before", gaussians, method)
    cover = watermarks.stored_scene(tmp_path / "cover", gaussians, method, scenes.rig())
    key, other = (
        run_stage(draw_key, DrawKeyParameters(seed=seed), {}, tmp_path / f"key {seed}")["key"] for seed in (1, 2)
    )
    given: Inputs = {"container": before, "cover": cover, "key": key}
    grain = run_stage(add_grain, AddGrainParameters(method="plain", level=3), given, tmp_path / "grain")["container"]
    assert not grain.private
    asked: Inputs = {
        "container": grain,
        "before": before,
        "cover": cover,
        "watermark": watermarks.emblem(tmp_path / "emblem"),
        "photos": watermarks.capture(tmp_path / "photos"),
    }
    parameters = DetectWatermarkParameters(method="plain", reader="grain", renders=4, negatives=8, shipped_photos=())
    found = {}
    for name, held in (("owner", {"key": key}), ("other", {"key": other}), ("none", {})):
        made = run_stage(detect_watermark, parameters, asked | held, tmp_path / name)
        assert made["scores"].private
        rows = read_measurements(made["scores"])
        found[name] = {(row.quantity, row.condition): row.value for row in rows}
    owners = found["owner"]
    assert owners[DETECTED, CLEAN_CHANNEL] == 1
    assert owners[TRIALS, CLEAN_CHANNEL] == len(read_scene(cover).test_names) + 4, "no render sets a threshold"
    assert owners[THRESHOLD, CLEAN_CHANNEL] == FOUND_SHARE
    assert owners[PSNR_WATERMARK, PICTURES_WITH_IT] > 40
    assert (owners[TRIALS, OWN_SCENE], owners[TRIALS, OTHER_SCENES]) == (8, 0)
    assert owners[FALSE_POSITIVES, OWN_SCENE] == 0
    assert {PRUNING, QUANTISATION, NOISE} <= {condition for _, condition in owners}
    for stranger in ("other", "none"):
        assert found[stranger][PSNR_WATERMARK, PICTURES_WITH_IT] < 15


def test_what_was_seen_before_a_stop_is_not_looked_at_again(
    tmp_path: Path, inputs: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: Inputs = {
        **inputs,
        "container": finetuned(tmp_path / "marked", inputs)["container"],
        "before": inputs["container"],
        "photos": watermarks.capture(tmp_path / "photos"),
    }
    parameters = DetectWatermarkParameters(method="plain", renders=4, negatives=9, shipped_photos=())
    looked: list[int] = []
    look = Detector._look
    monkeypatch.setattr(Detector, "_look", lambda detector, picture: looked.append(1) or look(detector, picture))
    undisturbed = run_stage(detect_watermark, parameters, given, tmp_path / "whole")
    looks = len(looked)
    scratch = tmp_path / "scratch"
    scratch.mkdir()

    def attempt(number: int, asking: Asking) -> dict[str, Artifact]:
        place = tmp_path / str(number)
        place.mkdir()
        (place / ".scratch").symlink_to(scratch)
        return run_stage(detect_watermark, parameters, given, place, services=asking.services())

    looked.clear()
    with pytest.raises(Interrupted, match=f"stopped before picture [0-9]+ of {looks}"):
        attempt(1, Asking(stop_at=50))
    assert 0 < len(looked) < looks
    made = attempt(2, Asking())
    assert made["scores"].digest == undisturbed["scores"].digest
    assert len(looked) == looks


def test_every_look_is_counted() -> None:
    black = np.zeros((6, 8, 3), np.uint8)
    positives = Positives([("0.png", black)], [black] * 2, [black] * 3, [(PRUNING, 0.25, [black] * 4)])
    looks = []
    detector = Detector(lambda picture: torch.zeros(picture.shape), black + 9)
    rows = list(trial_rows(detector, positives, [], 0, lambda: looks.append(1)))
    assert len(looks) == positives.looked_at
    [trials] = [row for row in rows if (row.quantity, row.condition) == (TRIALS, PRUNING)]
    assert (trials.severity, trials.value) == (0.25, 4)


@pytest.mark.parametrize(("own_share", "found"), [(0.75, 1), (0.8, 0), (None, 1)])
def test_a_threshold_that_is_known_is_kept_whatever_renders_reach(own_share: float | None, found: float) -> None:
    picture = np.full((6, 8, 3), 200, np.uint8)
    detector = Detector(lambda shown: torch.full(shown.shape, 0.55 * 200 / 255), picture, own_share)  # 0.7975 of it
    rows = trial_rows(detector, Positives([("0.png", picture)], [picture], []), [], 0, lambda: None)
    values = {(row.quantity, row.condition): row.value for row in rows}
    assert values[DETECTED, CLEAN_CHANNEL] == found
    assert values[THRESHOLD, CLEAN_CHANNEL] == (own_share or pytest.approx(0.7975))


def test_a_decoder_is_asked_for_where_one_is_to_read(tmp_path: Path, inputs: Inputs) -> None:
    given = {name: inputs[name] for name in ("cover", "watermark")}
    given |= {"container": small.splats(tmp_path / "marked", "container"), "before": inputs["container"]}
    given |= {"photos": watermarks.capture(tmp_path / "photos")}
    with pytest.raises(UserError, match="no decoder"):
        run_stage(detect_watermark, DetectWatermarkParameters(method="plain"), given, tmp_path / "made")


def test_a_decoder_that_always_shows_it_is_wrong_everywhere(tmp_path: Path, inputs: Inputs) -> None:
    image = inputs["watermark"]
    assert isinstance(image, Artifact)
    emblem = torch.from_numpy(image.read("picture")).permute(2, 0, 1) / 255
    given: Inputs = {
        **inputs,
        "container": finetuned(tmp_path / "marked", inputs)["container"],
        "before": inputs["container"],
        "codec": watermarks.codec(tmp_path / "stubborn", tuned_to=emblem),
        "photos": watermarks.capture(tmp_path / "photos"),
        "other_photos": (watermarks.capture(tmp_path / "others", seed=5),),
    }
    parameters = DetectWatermarkParameters(method="plain", renders=4, negatives=9, shipped_photos=())
    made = run_stage(detect_watermark, parameters, given, tmp_path / "made")
    assert made["scores"].private
    rows = {(row.quantity, row.condition): row.value for row in read_measurements(made["scores"])}
    assert rows[DETECTED, CLEAN_CHANNEL] == 1
    assert rows[TRIALS, OTHER_SCENES] == rows[FALSE_POSITIVES, OTHER_SCENES] == 9
    assert rows[TRIALS, OWN_SCENE] == rows[FALSE_POSITIVES, OWN_SCENE] == 10, "as many, half of each kind"
    assert (rows[SCENES, OTHER_SCENES], rows[SCENES, OWN_SCENE]) == (1, 1)


def test_photos_of_other_things_are_tried_with_noise_too(
    tmp_path: Path, inputs: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    grey = np.full((60, 80, 3), 128, np.uint8)
    monkeypatch.setattr("stages.detect_watermark.read_photo", lambda name: grey)
    tried: list[np.ndarray] = []
    look = Detector._look
    monkeypatch.setattr(Detector, "_look", lambda detector, picture: tried.append(picture) or look(detector, picture))
    given: Inputs = {
        **inputs,
        "container": finetuned(tmp_path / "marked", inputs)["container"],
        "before": inputs["container"],
        "photos": watermarks.capture(tmp_path / "photos"),
    }
    parameters = DetectWatermarkParameters(method="plain", renders=4, negatives=3, shipped_photos=())
    parameters = parameters.model_copy(update={"shipped_photos": ("coffee.png",)})
    made = run_stage(detect_watermark, parameters, given, tmp_path / "made")
    rows = {(row.quantity, row.condition): row.value for row in read_measurements(made["scores"])}
    assert (rows[TRIALS, OTHER_PHOTOS], rows[TRIALS, NOISY_PHOTOS], rows[TRIALS, OTHER_SCENES]) == (3, 3, 3)
    deviations = [float(picture.std()) for picture in tried[-6:]]
    assert deviations[:3] == [0, 0, 0]
    assert deviations[3:] == pytest.approx([5, 5, 5], rel=0.2)


def test_photos_of_the_cover_are_those_of_its_test_views(tmp_path: Path, inputs: Inputs) -> None:
    """Training views are what decoders learnt from: here they alone are white, and no white one is looked at."""
    scene = read_scene(cast(Artifact, inputs["cover"]))
    white, black = (np.full((48, 64, 3), level, np.uint8) for level in (255, 0))
    files = {name: black if name in scene.test_names else white for name in scene.cameras.names}
    photos = watermarks.stored_capture(tmp_path / "photos", files)
    assert [photo.max() for photo in _test_photos(photos, scene)] == [0] * len(scene.test_names)
    renamed = watermarks.stored_capture(tmp_path / "renamed", {f"other {name}": files[name] for name in files})
    found = _test_photos(renamed, scene)
    np.testing.assert_array_equal(found, scene.pictures[scene.rows(scene.test_names)])
