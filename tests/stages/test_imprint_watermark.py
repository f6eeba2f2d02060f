"""An imprint changes only what Gaussians look like, until their renders show the watermark to the owner."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact
from pipeline.errors import Interrupted
from stages.analysis.detection import explained_share
from stages.hide_image import hide_image
from stages.hide_scenes import hide_scenes
from stages.hiding.rendering import COVER
from stages.hiding.storage import read_gaussians, read_method
from stages.hiding.watermark.grain import ROUNDS, measuring_cameras
from stages.hiding.watermark.rendering import renders
from stages.hiding.watermark.storage import read_codec
from stages.imaging.metric_table import read_rows
from stages.imaging.pictures import picture_to_tensor
from stages.imprint_watermark import ImprintWatermarkParameters, imprint_watermark
from stages.scene.gaussians import GEOMETRY
from stages.scene.scene import read_scene
from stages.training.decoder_tuning import CLEAN, PHOTOS, RENDERS, decoded
from stages.training.imprinting import OTHERS, Imprinting, ImprintPictures, ImprintSettings
from stages.training.views import training_views
from tests.running import run_stage
from tests.stages import small, watermarks
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


def parameters(**settings: object) -> ImprintWatermarkParameters:
    return ImprintWatermarkParameters.model_validate(
        {"method": "plain", "iterations": 6, "shipped_photos": ()} | settings
    )


def imprinting(inputs: Inputs, settings: ImprintSettings) -> Imprinting:
    scene, container = read_scene(given(inputs, "cover")), given(inputs, "container")
    views = training_views(scene)
    pictures = ImprintPictures(views, [*scene.pictures], given(inputs, "watermark").read("picture"))
    marked, clean = (read_gaussians(container) for _ in range(2))
    return Imprinting(marked, clean, read_method(container), watermarks.little_codec(), pictures, settings)


def given(inputs: Inputs, name: str) -> Artifact:
    artifact = inputs[name]
    assert isinstance(artifact, Artifact)
    return artifact


def sorted_rows(splats: Artifact, name: str) -> np.ndarray:
    return splats.read(name)[np.lexsort(splats.read("means").T)]


def test_only_colours_change_and_the_decoder_is_the_owners(tmp_path: Path, inputs: Inputs) -> None:
    before = given(inputs, "container")
    photos = watermarks.capture(tmp_path / "others", seed=5)
    made = run_stage(imprint_watermark, parameters(distorted=True), inputs | {"photos": (photos,)}, tmp_path / "made")
    container = made["container"]
    for name in GEOMETRY:
        np.testing.assert_array_equal(container.read(name), sorted_rows(before, name))
    assert not np.array_equal(container.read("sh_base"), sorted_rows(before, "sh_base"))
    assert not any("/" in name for name in container.names), "nothing of the decoder is published"
    assert not container.private
    assert made["codec"].private
    assert {row.method for row in read_rows(made["curves"])} == {"cover", RENDERS, PHOTOS, CLEAN, OTHERS}


def test_renders_show_the_watermark_and_those_from_before_do_not(tmp_path: Path, inputs: Inputs) -> None:
    wanted = parameters(iterations=400, level=20, first_level=30, decoder_rate=5e-3, feature_rate=0.02)
    larger = watermarks.codec(tmp_path / "larger", blocks=2, width=8)
    made = run_stage(imprint_watermark, wanted, inputs | {"codec": larger}, tmp_path / "made")
    scene, codec = read_scene(given(inputs, "cover")), read_codec(made["codec"])
    watermark = picture_to_tensor(given(inputs, "watermark").read("picture"))
    shown = {
        name: renders(read_gaussians(container), read_method(container), scene.cameras, lambda: None)
        for name, container in (("before", given(inputs, "container")), ("after", made["container"]))
    }
    with torch.no_grad():
        shares = {name: [explained_share(decoded(codec, each), watermark) for each in shown[name]] for name in shown}
    assert min(shares["after"]) > max(shares["before"]) + 0.05
    changes = (shown["after"].astype(float) - shown["before"]) ** 2
    assert np.sqrt(changes.mean(axis=(1, 2, 3)))[len(scene.test_names) :].max() < 1.2 * 20


def test_what_the_secret_shows_is_held_on_to(tmp_path: Path, inputs: Inputs) -> None:
    few = {"iterations": 3, "decoder_width": 8, "feature_dim": 8, "layers": 2}
    messages, image = (small.message_views(tmp_path / "views"),), inputs["watermark"]
    for declared, hidden, name in (
        (hide_scenes, {"messages": messages}, "statue"),
        (hide_image, {"image": image}, "emblem"),
    ):
        settings = declared.parameters.model_validate(few)
        made = run_stage(declared, settings, hidden | {"cover": inputs["cover"]}, tmp_path / name)
        asked = inputs | {"container": made["container"], "secret": made["secret"]}
        after = run_stage(imprint_watermark, parameters(method="gs_hider"), asked, tmp_path / f"{name} after")
        for array in made["container"].names:
            if array != "raw_features":
                np.testing.assert_array_equal(after["container"].read(array), made["container"].read(array))
        assert name in {row.method for row in read_rows(after["curves"])}


def test_levels_fall_and_only_what_exceeds_them_counts(inputs: Inputs) -> None:
    training = imprinting(inputs, ImprintSettings(100, 0, level=2, settling_share=0.5))
    allowed = [training.allowed(COVER, progress) for progress in (0, 0.25, 0.5, 1)]
    assert allowed == pytest.approx([20, 40**0.5, 2, 2])
    assert training.allowed("statue", 0.5) == ImprintSettings(1, 0, 2).message_level
    under, over = (torch.tensor((level / 255) ** 2) for level in (1.9, 4))
    assert training.weighed(COVER, under, 1) == 0
    assert float(training.weighed(COVER, over, 1)) == pytest.approx(3)
    assert training.weighed(RENDERS, over, 1) == over
    assert training.weighed(CLEAN, over, 1) == over / 2


def test_the_grain_of_what_no_view_shows_fades_too(inputs: Inputs) -> None:
    training = imprinting(inputs, ImprintSettings(8, 0, level=2, settling_share=1))
    before = training.clean["sh_base"].clone()
    with torch.no_grad():
        training.gaussians["means"][0] = 1e6  # where no camera sees it
        training.gaussians["sh_base"][0] += 1
    training.step()
    assert training.gaussians["sh_base"][0].detach() - before[0] == pytest.approx(0.1 ** (1 / 8), abs=1e-6)
    while training.iteration < training.iterations:
        training.step()
    assert training.gaussians["sh_base"][0].detach() - before[0] == pytest.approx(0.1, abs=1e-6)


def test_what_is_not_distorted_is_rounded_where_it_is(inputs: Inputs, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a GPU, rounding each picture on the CPU would wait for all queued work."""
    monkeypatch.setattr("stages.training.imprinting.tensor_to_picture", None)
    imprinting(inputs, ImprintSettings(8, 0, level=2)).step()


def test_it_goes_on_where_it_was_stopped(tmp_path: Path, inputs: Inputs) -> None:
    wanted = parameters(iterations=12, distorted=True)
    undisturbed = run_stage(imprint_watermark, wanted, inputs, tmp_path / "whole")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    place = tmp_path / "stopped"
    place.mkdir()
    (place / ".scratch").symlink_to(scratch)
    assert isinstance(inputs["cover"], Artifact)
    measured = len(measuring_cameras(read_scene(inputs["cover"])))
    looks = small.VIEWS - 1  # one for each training view, at the renders from before
    looks += measured * (1 + ROUNDS + 2)  # before the grain, after each of its rounds, and for the level it shows
    with pytest.raises(Interrupted, match="stopped after step 5 of 12"):
        run_stage(imprint_watermark, wanted, inputs, place, services=Asking(looks + 5).services())
    place = tmp_path / "resumed"
    place.mkdir()
    (place / ".scratch").symlink_to(scratch)
    resumed = run_stage(imprint_watermark, wanted, inputs, place)
    assert {port: each.digest for port, each in resumed.items()} == {
        port: each.digest for port, each in undisturbed.items()
    }
