"""A watermark is found where it is, and whatever a reader takes for it elsewhere is counted, scene by scene."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.errors import Interrupted, UserError
from pipeline.stage import Services
from stages.add_grain import AddGrainParameters, add_grain
from stages.analysis.measurements import Measurement, read_measurements
from stages.analysis.watermark_trials import (
    CLEAN_CHANNEL,
    CONTAINER_NOISE,
    COVER_AFTER,
    COVER_BEFORE,
    COVER_CONTROL,
    DETECTED,
    FALSE_POSITIVES,
    FALSE_POSITIVES_DISTORTED,
    NEGATIVES_DISTORTED,
    OTHER_SCENES,
    OWN_SCENE,
    PRUNING,
    PSNR_WATERMARK,
    QUANTISATION,
    SCENES,
    THRESHOLD,
    TRIALS,
    Detector,
    Negative,
    Positives,
)
from stages.analysis.watermark_trials import RENDERS as PICTURES_WITH_IT
from stages.detect_watermark import (
    NOISY_PHOTOS,
    OTHER_PHOTOS,
    OTHER_RENDERS,
    DetectWatermarkParameters,
    _test_photos,
    detect_watermark,
)
from stages.draw_key import DrawKeyParameters, draw_key
from stages.hiding.method import Method
from stages.hiding.photographs import photographs
from stages.hiding.rendering import Rendering
from stages.hiding.storage import read_gaussians, read_method
from stages.hiding.watermark.reading import FOUND_SHARE, owners_reader
from stages.hiding.watermark.rendering import renders
from stages.imaging.image import filling, read_image
from stages.imaging.pictures import Picture, picture_to_tensor
from stages.imaging.psnr import psnr
from stages.scene.cameras import Cameras
from stages.scene.gaussians import Gaussians
from stages.scene.scene import read_scene
from tests.running import run_stage
from tests.stages import small, watermarks
from tests.stages.hiding.relocalisation import scenes
from tests.stages.test_edit_splats import enlarged
from tests.stages.test_stopping import Asking
from tests.stages.watermarks import Inputs, finetuned, inputs_of_rtws


@pytest.fixture
def inputs(tmp_path: Path) -> Inputs:
    return inputs_of_rtws(tmp_path)


@dataclass(frozen=True)
class Trial:
    """What `detect_watermark` tried, with 4 new cameras and seed 5, and its rows on the cover's fidelity."""

    detector: Detector
    positives: Positives
    negatives: list[Negative]
    seed: int
    rows: list[Measurement]


@pytest.fixture
def given(tmp_path: Path, inputs: Inputs) -> Inputs:
    """A watermarked container, and two other captures, each with its photos, scene and splats."""
    others = range(2)
    return {
        **inputs,
        "container": finetuned(tmp_path / "marked", inputs)["container"],
        "before": inputs["container"],
        "control": finetuned(tmp_path / "control", inputs, marked=False)["container"],
        "photos": watermarks.capture(tmp_path / "photos"),
        "other_photos": tuple(watermarks.capture(tmp_path / f"photos {each}", seed=5 + each) for each in others),
        "other_scenes": tuple(small.scene(tmp_path / f"scene {each}") for each in others),
        "other_splats": tuple(small.splats(tmp_path / f"splats {each}") for each in others),
    }


@pytest.fixture
def trial(tmp_path: Path, given: Inputs, monkeypatch: pytest.MonkeyPatch) -> Trial:
    tried: list[tuple[Detector, Positives, list[Negative], int]] = []

    def trial_rows(
        detector: Detector,
        positives: Positives,
        negatives: Iterable[tuple[Negative, Picture]],
        seed: int,
        after_each: Callable[[], None],
    ) -> list[Measurement]:
        tried.append((detector, positives, [negative for negative, _ in negatives], seed))
        return []

    monkeypatch.setattr("stages.detect_watermark.trial_rows", trial_rows)
    parameters = DetectWatermarkParameters(method="plain", renders=4, negatives=8, shipped_photos=(), seed=5)
    made = run_stage(detect_watermark, parameters, given, tmp_path / "tried")
    [(detector, positives, negatives, seed)] = tried
    return Trial(detector, positives, negatives, seed, read_measurements(made["scores"]))


def test_renders_that_set_the_threshold_are_not_scored(trial: Trial) -> None:
    calibration, others = trial.positives.calibration, trial.positives.others
    assert (len(calibration), len(others)) == (2, 2)
    assert not {each.tobytes() for each in calibration} & {each.tobytes() for each in others}
    for attacked in trial.positives.attacked:
        for picture, other, used in zip(attacked.renders(), others, calibration, strict=True):
            shown, same, different = map(picture_to_tensor, (picture, other, used))
            assert psnr(shown, same) > psnr(shown, different), "attacked renders are by the cameras that are scored"


def test_renders_of_attacked_containers_are_made_when_their_turn_comes(
    tmp_path: Path, given: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of six attacks, with large pictures, need not fit into memory."""
    events: list[str] = []
    look = Detector._look

    def counted(gaussians: Gaussians, method: Method, cameras: Cameras) -> Iterator[Rendering]:
        for rendering in photographs(gaussians, method, cameras):
            events.append("render")
            yield rendering

    monkeypatch.setattr("stages.hiding.watermark.rendering.photographs", counted)
    monkeypatch.setattr(Detector, "_look", lambda *of: events.append("look") or look(*of))
    parameters = DetectWatermarkParameters(method="plain", renders=4, negatives=2, shipped_photos=())
    asked = {port: artifact for port, artifact in given.items() if not port.startswith("other_")}
    run_stage(detect_watermark, parameters, asked, tmp_path / "tried")
    trial = events[events.index("look") :]
    assert trial.count("render") == 6 * 2 + 1, "six attacks, and the cover from before"
    assert ("render", "render") not in pairwise(trial)


def test_distortions_follow_the_seed_and_the_watermark_fills_the_picture(trial: Trial, given: Inputs) -> None:
    assert trial.seed == 5
    cameras = read_scene(cast(Artifact, given["cover"])).cameras
    image = read_image(cast(Artifact, given["watermark"]))[1]
    np.testing.assert_array_equal(trial.detector.watermark, filling(image, cameras.width, cameras.height))
    assert cameras.width != cameras.height
    assert trial.detector.own_share is None


@pytest.mark.parametrize(
    ("port", "what"),
    [
        ("other_scenes", "the clean models' scenes and splats"),
        ("other_splats", "the clean models' scenes and splats"),
        ("other_photos", "the other captures' photos and splats"),
    ],
)
def test_other_captures_pair_up(tmp_path: Path, given: Inputs, port: str, what: str) -> None:
    fewer = {**given, port: cast(tuple[Artifact, ...], given[port])[:1]}
    parameters = DetectWatermarkParameters(method="plain", renders=4, negatives=8, shipped_photos=())
    with pytest.raises(UserError, match=f"{what} do not pair up"):
        run_stage(detect_watermark, parameters, fewer, tmp_path / "tried")


def test_splats_of_another_world_are_refused_before_any_work(
    tmp_path: Path, given: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stages.detect_watermark.read_scene", lambda _: pytest.fail("work began"))
    _, enlarged_splats = enlarged(tmp_path / "enlarged")
    mixed = {**given, "other_splats": (enlarged_splats, cast(tuple[Artifact, ...], given["other_splats"])[1])}
    parameters = DetectWatermarkParameters(method="plain", renders=4, negatives=8, shipped_photos=())
    with pytest.raises(UserError, match="not in the world of the cameras"):
        run_stage(detect_watermark, parameters, mixed, tmp_path / "tried")


@pytest.mark.parametrize("name", ["before", "control"])
def test_everything_that_is_drawn_must_be_of_the_declared_method(tmp_path: Path, given: Inputs, name: str) -> None:
    """Only the declared method's code is part of the result's key, and the rows bear its name."""
    with create(tmp_path / "other", "container") as writer:
        writer.attributes.update(method="gs_hider")
    mixed = {**given, name: load(tmp_path / "other")}
    parameters = DetectWatermarkParameters(method="plain", renders=4, negatives=8, shipped_photos=())
    with pytest.raises(UserError, match="made by another method"):
        run_stage(detect_watermark, parameters, mixed, tmp_path / "tried")


def test_splats_from_before_are_plain_whatever_the_method_is(tmp_path: Path, given: Inputs) -> None:
    with create(tmp_path / "hiding", "container") as writer:
        writer.attributes.update(method="gs_hider")
    mixed = {**given, "container": load(tmp_path / "hiding"), "before": small.splats(tmp_path / "before")}
    del mixed["codec"], mixed["control"]
    parameters = DetectWatermarkParameters(method="gs_hider", renders=4, negatives=8, shipped_photos=())
    with pytest.raises(UserError, match="no decoder to detect the watermark with"):
        run_stage(detect_watermark, parameters, mixed, tmp_path / "tried")


def test_a_container_of_another_method_is_refused(tmp_path: Path, given: Inputs) -> None:
    parameters = DetectWatermarkParameters(method="gs_hider", renders=4, negatives=8, shipped_photos=())
    with pytest.raises(UserError, match="made by another method"):
        run_stage(detect_watermark, parameters, given, tmp_path / "tried")


def test_the_covers_fidelity_before_and_after_is_that_of_these_containers(trial: Trial, given: Inputs) -> None:
    scene = read_scene(cast(Artifact, given["cover"]))
    cameras, truth = scene.cameras.select(scene.test_names), scene.pictures[scene.rows(scene.test_names)][0]
    wanted = {}
    ports = {COVER_BEFORE: "before", COVER_CONTROL: "control", COVER_AFTER: "container"}
    for condition, port in ports.items():
        stored = cast(Artifact, given[port])
        [shown] = renders(read_gaussians(stored), read_method(stored), cameras, lambda: None)
        wanted[condition] = pytest.approx(psnr(picture_to_tensor(shown), picture_to_tensor(truth)))
    assert {row.condition: row.value for row in trial.rows} == wanted
    assert len({each.expected for each in wanted.values()}) == len(ports)


def test_photos_and_renders_of_a_capture_are_one_scene(trial: Trial) -> None:
    photos, shown = (
        {each.scene for each in trial.negatives if each.kind == kind} for kind in (OTHER_PHOTOS, OTHER_RENDERS)
    )
    assert photos == shown
    assert len(photos) == 2


@pytest.mark.slow  # half a minute: it looks at every distortion of every attacked container
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
    made = run_stage(detect_watermark, parameters, asked | {"key": key}, tmp_path / "made")
    assert made["scores"].private
    owners = {(row.quantity, row.condition): row.value for row in read_measurements(made["scores"])}
    assert owners[DETECTED, CLEAN_CHANNEL] == 1
    assert owners[TRIALS, CLEAN_CHANNEL] == len(read_scene(cover).test_names) + 4, "no render sets a threshold"
    assert owners[THRESHOLD, CLEAN_CHANNEL] == FOUND_SHARE
    assert owners[PSNR_WATERMARK, PICTURES_WITH_IT] > 40
    assert (owners[TRIALS, OWN_SCENE], owners[TRIALS, OTHER_SCENES]) == (2 + 4, 0), "each photo is one window"
    assert owners[FALSE_POSITIVES, OWN_SCENE] == 0
    assert {PRUNING, QUANTISATION, CONTAINER_NOISE} <= {condition for _, condition in owners}
    marked = scenes.photograph(read_gaussians(grain), read_method(grain), scenes.beside(scenes.rig()))
    certainties = {
        held: owners_reader(before, read_scene(cover), held, seed=0).certainty(marked) for held in (key, other, None)
    }
    assert {held for held, certainty in certainties.items() if certainty > 0.01} == {key}


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
    with pytest.raises(Interrupted, match=r"stopped before picture \d+ of at most \d+"):
        attempt(1, Asking(stop_at=50))
    assert 0 < len(looked) < looks
    made = attempt(2, Asking())
    assert made["scores"].digest == undisturbed["scores"].digest
    assert len(looked) == looks


def test_a_decoder_is_asked_for_where_one_is_to_read(tmp_path: Path, inputs: Inputs) -> None:
    given = {name: inputs[name] for name in ("cover", "watermark")}
    given |= {"container": small.splats(tmp_path / "marked", "container"), "before": inputs["container"]}
    given |= {"photos": watermarks.capture(tmp_path / "photos")}
    with pytest.raises(UserError, match="no decoder"):
        run_stage(detect_watermark, DetectWatermarkParameters(method="plain"), given, tmp_path / "made")


def test_a_decoder_that_always_shows_it_is_wrong_everywhere(tmp_path: Path, inputs: Inputs) -> None:
    image = inputs["watermark"]
    assert isinstance(image, Artifact)
    emblem = torch.from_numpy(image.read("picture")) / 255
    given: Inputs = {
        **inputs,
        "container": finetuned(tmp_path / "marked", inputs)["container"],
        "before": inputs["container"],
        "codec": watermarks.codec(tmp_path / "stubborn", tuned_to=emblem),
        "photos": watermarks.capture(tmp_path / "photos"),
        "other_photos": (watermarks.capture(tmp_path / "others", seed=5),),
    }
    parameters = DetectWatermarkParameters(method="plain", renders=4, negatives=9, distorted_of=4, shipped_photos=())
    made = run_stage(detect_watermark, parameters, given, tmp_path / "made")
    assert made["scores"].private
    rows = {(row.quantity, row.condition): row.value for row in read_measurements(made["scores"])}
    assert rows[DETECTED, CLEAN_CHANNEL] == 1
    assert rows[TRIALS, OTHER_SCENES] == rows[FALSE_POSITIVES, OTHER_SCENES] == 8, "photos of which each is one window"
    assert rows[TRIALS, OWN_SCENE] == rows[FALSE_POSITIVES, OWN_SCENE] == 1 + 5, "of the test view, and renders"
    assert (rows[SCENES, OTHER_SCENES], rows[SCENES, OWN_SCENE]) == (1, 1)
    assert rows[NEGATIVES_DISTORTED, "noise"] == rows[FALSE_POSITIVES_DISTORTED, "noise"] == 2


def test_photos_of_other_things_are_tried_with_noise_too(
    tmp_path: Path, inputs: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    grey = np.full((60, 80, 3), 128, np.uint8)
    monkeypatch.setattr("stages.detect_watermark.read_photo", lambda name, longest: grey)
    tried: list[np.ndarray] = []
    look = Detector._look
    monkeypatch.setattr(Detector, "_look", lambda detector, picture: tried.append(picture) or look(detector, picture))
    given: Inputs = {
        **inputs,
        "container": finetuned(tmp_path / "marked", inputs)["container"],
        "before": inputs["container"],
        "photos": watermarks.capture(tmp_path / "photos"),
    }
    parameters = DetectWatermarkParameters(method="plain", renders=4, negatives=3, shipped_photos=(), distorted_of=0)
    parameters = parameters.model_copy(update={"shipped_photos": ("coffee.png",)})
    seen: list[tuple[float, float]] = []
    services = Services(progress=lambda done, total, figures: seen.append((done, total)))
    made = run_stage(detect_watermark, parameters, given, tmp_path / "made", services=services)
    done, total = seen[-1]
    assert (done, total) == (len(tried), len(tried) + 1), "its own photo has one window in place of two"
    rows = {(row.quantity, row.condition): row.value for row in read_measurements(made["scores"])}
    assert (rows[TRIALS, OTHER_PHOTOS], rows[TRIALS, NOISY_PHOTOS], rows[TRIALS, OTHER_SCENES]) == (3, 3, 3)
    deviations = [float(picture.std()) for picture in tried[-6:]]
    assert deviations[:3] == [0, 0, 0]
    assert deviations[3:] == pytest.approx([5, 5, 5], rel=0.2)


def test_the_log_says_how_many_photos_are_smaller_than_the_scene(
    tmp_path: Path, given: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One is a pixel too narrow: it would have to be enlarged."""
    photos = {
        "coffee.png": np.zeros((60, 80, 3), np.uint8),
        "brick.png": np.zeros((small.HEIGHT, small.WIDTH - 1, 3), np.uint8),
    }
    monkeypatch.setattr("stages.detect_watermark.read_photo", lambda name, longest: photos[name])
    monkeypatch.setattr("stages.detect_watermark.trial_rows", lambda _, __, negatives, *rest: [*negatives][:0])
    parameters = DetectWatermarkParameters(method="plain", renders=2, negatives=2, shipped_photos=())

    def log(*names: str) -> list[str]:
        asking, chosen = Asking(), parameters.model_copy(update={"shipped_photos": names})
        run_stage(detect_watermark, chosen, given, tmp_path / " ".join(names), services=asking.services())
        return [line for line in asking.lines if "shipped" in line]

    told = "1 of 2 shipped photos are as large as the scene's pictures; the others are left out"
    assert log("coffee.png", "brick.png") == [told]
    assert log("coffee.png") == []


def test_photos_of_the_cover_are_those_of_its_test_views(tmp_path: Path, inputs: Inputs) -> None:
    """Decoders learnt from training views: here only they are white, and no white photo is returned."""
    scene = read_scene(cast(Artifact, inputs["cover"]))
    white, black = (np.full((48, 64, 3), level, np.uint8) for level in (255, 0))
    files = {name: black if name in scene.test_names else white for name in scene.cameras.names}
    photos = watermarks.stored_capture(tmp_path / "photos", files)
    assert [photo.max() for photo in _test_photos(photos, scene)] == [0] * len(scene.test_names)
    renamed = watermarks.stored_capture(tmp_path / "renamed", {f"other {name}": files[name] for name in files})
    found = _test_photos(renamed, scene)
    np.testing.assert_array_equal(found, scene.pictures[scene.rows(scene.test_names)])
