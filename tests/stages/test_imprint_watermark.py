"""An imprint changes what Gaussians look like and nothing else, until their renders show the watermark to its owner."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact
from pipeline.errors import Interrupted, UserError
from pipeline.stage import run_stage
from stages.analysis.detection import explained_share
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding.storage import read_gaussians, read_method
from stages.hiding.watermark.rendering import renders
from stages.hiding.watermark.storage import read_codec
from stages.imaging.metric_table import read_rows
from stages.imaging.pictures import picture_to_tensor
from stages.imprint_watermark import ImprintWatermarkParameters, imprint_watermark
from stages.scene.gaussians import GEOMETRY
from stages.scene.scene import read_scene
from stages.training.decoder_tuning import CLEAN, PHOTOS, RENDERS, decoded
from stages.training.imprinting import OTHERS
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
    wanted = parameters(iterations=300, watermark_weight=1, final_watermark_weight=1, feature_rate=0.02)
    made = run_stage(imprint_watermark, wanted, inputs, tmp_path / "made")
    scene, codec = read_scene(given(inputs, "cover")), read_codec(made["codec"])
    watermark = picture_to_tensor(given(inputs, "watermark").read("picture"))
    shares = {}
    for name, container in (("before", given(inputs, "container")), ("after", made["container"])):
        shown = renders(read_gaussians(container), read_method(container), scene.cameras, lambda: None)
        with torch.no_grad():
            shares[name] = [explained_share(decoded(codec, picture), watermark) for picture in shown]
    assert min(shares["after"]) > 0.6
    assert max(shares["before"]) < 0.4


def test_messages_are_held_on_to(tmp_path: Path, inputs: Inputs) -> None:
    settings = HideScenesParameters(iterations=3, decoder_width=8, feature_dim=8, layers=2)
    messages = (small.message_views(tmp_path / "views"),)
    hidden = run_stage(hide_scenes, settings, {"cover": inputs["cover"], "messages": messages}, tmp_path / "hidden")
    given_messages = inputs | {"container": hidden["container"], "messages": messages}
    wanted = parameters(method="gs_hider")
    after = run_stage(imprint_watermark, wanted, given_messages | {"secret": hidden["secret"]}, tmp_path / "made")
    for name in hidden["container"].names:
        if name != "raw_features":
            np.testing.assert_array_equal(after["container"].read(name), hidden["container"].read(name))
    assert "statue" in {row.method for row in read_rows(after["curves"])}
    with pytest.raises(UserError, match="nothing says which view hides the image; found no secret"):
        run_stage(imprint_watermark, wanted, given_messages | {"image": inputs["watermark"]}, tmp_path / "refused")


def test_it_goes_on_where_it_was_stopped(tmp_path: Path, inputs: Inputs) -> None:
    wanted = parameters(iterations=12, distorted=True)
    undisturbed = run_stage(imprint_watermark, wanted, inputs, tmp_path / "whole")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    place = tmp_path / "stopped"
    place.mkdir()
    (place / ".scratch").symlink_to(scratch)
    with pytest.raises(Interrupted, match="stopped after step 5 of 12"):
        run_stage(imprint_watermark, wanted, inputs, place, services=Asking(small.VIEWS - 1 + 5).services())
    place = tmp_path / "resumed"
    place.mkdir()
    (place / ".scratch").symlink_to(scratch)
    resumed = run_stage(imprint_watermark, wanted, inputs, place)
    assert {port: each.digest for port, each in resumed.items()} == {
        port: each.digest for port, each in undisturbed.items()
    }
