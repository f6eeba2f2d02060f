"""The probe tells a decoder that decodes from one that has memorised its message."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.analysis.probes import OWN, PROBES, SILENT, probes, run_name
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding.method import build_method
from stages.hiding.rendering import COVER
from stages.imaging.metric_table import mean_value, read_rows
from stages.probe_decoder import ProbeDecoderParameters, probe_decoder
from stages.render_hidden import photograph_message
from stages.scene.gaussians import gaussians_at
from stages.scene.message_views import MessageViews, write_message_views
from stages.scene.scene import read_scene
from tests.running import run_stage
from tests.stages.small import scene

SETTINGS = {"iterations": 300, "decoder_width": 16, "feature_dim": 8, "message_points": 60, "lambda_message": 4.0}


def dotted_message(folder: Path, cover: Artifact) -> Artifact:
    """Sixty dots in random colours, seen from the cover's cameras: no two pictures resemble each other."""
    cameras = read_scene(cover).cameras
    generator = np.random.default_rng(2)
    points, colors = generator.uniform(-0.8, 0.8, (60, 3)), generator.uniform(0, 1, (60, 3))
    method = build_method("plain", {"sh_degree": 0})
    dots = gaussians_at(points, method.initial_attributes({COVER: colors}, generator))
    dots.parameters["logit_opacities"] += 5
    pictures, coverage = photograph_message(dots, method, cameras)
    shown = (colors * 255).astype(np.uint8)
    with create(folder, "views", private=True) as writer:
        write_message_views(
            writer, MessageViews("dots", cameras.names, pictures, points.astype(np.float32), shown, coverage)
        )
    return load(folder)


def probed(
    tmp_path: Path, method: str = "gs_hider", other_dim: int | None = None, **settings: object
) -> dict[str, float]:
    """The mean PSNR of each probe; the other container has `other_dim` channels, or is the same one."""
    cover = scene(tmp_path / "cover")
    views = dotted_message(tmp_path / "views", cover)
    parameters = HideScenesParameters.model_validate({**SETTINGS, "method": method, **settings})
    made = run_stage(hide_scenes, parameters, {"cover": cover, "messages": (views,)}, tmp_path / "made")
    other = made
    if other_dim is not None:
        wider = parameters.model_copy(update={"feature_dim": other_dim})
        other = run_stage(hide_scenes, wider, {"cover": cover, "messages": (views,)}, tmp_path / "other")
    inputs: dict[str, Artifact | tuple[Artifact, ...]] = {
        "container": made["container"],
        "secret": made["secret"],
        "cover": cover,
        "messages": (views,),
        "other": other["container"],
    }
    scores = run_stage(probe_decoder, ProbeDecoderParameters(method=method), inputs, tmp_path / "probed")["scores"]
    assert scores.private
    rows = [row for row in read_rows(scores) if row.quantity == "psnr_covered"]
    return {str(name): mean_value([row for row in rows if row.method == name]) for name in {row.method for row in rows}}


@pytest.mark.parametrize("method", ["gs_hider", "homogeneous"])
def test_only_the_containers_own_features_show_the_message(tmp_path: Path, method: str) -> None:
    found = probed(tmp_path, method)
    own = found.pop(run_name(method, OWN))
    assert len(found) == len(PROBES) - 1
    assert all(value < own - 1 for value in found.values()), (own, found)


def test_a_method_without_features_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no features"):
        probed(tmp_path, "decoder", iterations=1)


def test_a_container_that_hides_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="the container hides none of the messages"):
        probed(tmp_path, iterations=1, hidden=0)


def test_another_container_of_more_channels_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="found 9 for each Gaussian; expected 8"):
        probed(tmp_path, iterations=1, other_dim=9)


def test_probes_change_what_they_say() -> None:
    own = torch.randn(20, 6, generator=torch.Generator().manual_seed(0))
    foreign = torch.full((3, 6), 7.0)
    found = probes(own, foreign, seed=1)
    assert torch.equal(found[OWN], own)
    silenced = (found["half of the channels zeroed"] == SILENT).all(dim=0)
    assert int(silenced.sum()) == 3
    assert (found["features of another scene"] == 7).all()
    assert torch.equal(found["every Gaussian with the mean feature"][0], own.sigmoid().mean(dim=0).logit())


@pytest.mark.usefixtures("any_arrays")
def test_features_of_other_channels_are_refused() -> None:
    with pytest.raises(ValueError, match="6 and of 5 channels"):
        probes(torch.zeros(20, 6), torch.zeros(3, 5), seed=1)
