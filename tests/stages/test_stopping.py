"""Long stages stop when asked: trainings go on from there and make the same artifacts, others stop at once."""

from __future__ import annotations

import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import pytest

from pipeline.artifact import Artifact
from pipeline.errors import Interrupted
from pipeline.stage import Parameters, Services, Stage
from stages.add_grain import AddGrainParameters, add_grain
from stages.evaluate import EvaluateParameters, evaluate
from stages.find_grain import FindGrainParameters, find_grain
from stages.finetune_rtws import FinetuneRtwsParameters, finetune_rtws
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.photos import PhotosParameters, photos
from stages.render_hidden import RenderHiddenParameters, render_hidden
from stages.render_path import RenderPathParameters, render_path
from stages.time_frames import TimeFramesParameters, time_frames
from stages.train_scene import TrainSceneParameters, train_scene
from tests.running import run_stage
from tests.stages import small, watermarks
from tests.stages.watermarks import inputs_of_rtws

ITERATIONS = 120
"""Density control refines after 50 of them."""


@dataclass
class Asking:
    """Asks a stage to stop at its n-th check, and remembers what the stage said."""

    stop_at: int | None = None
    looks: int = 0
    lines: list[str] = field(default_factory=list)
    figures: list[Mapping[str, float]] = field(default_factory=list)

    def services(self) -> Services:
        return Services(lambda done, total, figures: self.figures.append(figures), self.lines.append, self.stops)

    def stops(self) -> bool:
        self.looks += 1
        return self.looks == self.stop_at


TRAININGS: dict[str, tuple[Stage, Parameters]] = {
    "plain": (train_scene, TrainSceneParameters(iterations=ITERATIONS, sh_degree=1, maximum_gaussians=90)),
    "gs_hider": (
        hide_scenes,
        HideScenesParameters(iterations=ITERATIONS, feature_dim=8, layers=2, decoder_width=8, message_points=20),
    ),
}


def inputs_of(declared: Stage, folder: Path) -> dict[str, Artifact | tuple[Artifact, ...]]:
    if declared is train_scene:
        return {"scene": small.scene(folder / "scene")}
    return {"cover": small.scene(folder / "scene"), "messages": (small.message_views(folder / "views"),)}


def attempt(
    declared: Stage, parameters: Parameters, folder: Path, scratch: Path, number: int, asking: Asking
) -> dict[str, Artifact] | None:
    """Runs a stage with the scratch directory of earlier attempts; None if it was stopped."""
    place = folder / f"attempt-{number}"
    place.mkdir()
    (place / ".scratch").symlink_to(scratch)
    try:
        return run_stage(declared, parameters, inputs_of(declared, place), place, services=asking.services())
    except Interrupted:
        return None


@pytest.mark.parametrize("name", TRAININGS)
def test_an_interrupted_training_makes_the_same_artifacts(name: str, tmp_path: Path) -> None:
    declared, parameters = TRAININGS[name]
    fresh, scratch = tmp_path / "fresh", tmp_path / "scratch"
    fresh.mkdir()
    scratch.mkdir()
    undisturbed = attempt(declared, parameters, tmp_path, fresh, 0, Asking())
    assert undisturbed
    for number, stop_at in enumerate([31, 22], start=1):  # the first check is before the first iteration
        asking = Asking(stop_at)
        assert attempt(declared, parameters, tmp_path, scratch, number, asking) is None
        assert [path.name for path in scratch.iterdir()] == [f"checkpoint-{number}"]
    for path in scratch.rglob("*"):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600)
    asking = Asking()
    resumed = attempt(declared, parameters, tmp_path, scratch, 3, asking)
    assert resumed
    assert {port: artifact.digest for port, artifact in resumed.items()} == {
        port: artifact.digest for port, artifact in undisturbed.items()
    }
    assert asking.lines[0].startswith(f"goes on from iteration 51 of {ITERATIONS} (checkpoint of 2")
    assert asking.looks == 1 + ITERATIONS - 51
    assert all(figures.keys() == {"loss", "psnr"} for figures in asking.figures)


def write_photos(folder: Path) -> Path:
    folder.mkdir()
    for name, picture in zip(small.NAMES, small.pictures(0), strict=True):
        cv2.imwrite(str(folder / name), picture)
    return folder


@pytest.mark.parametrize("stop_at", [1, 3])
@pytest.mark.parametrize(
    "declared",
    [add_grain, evaluate, find_grain, render_hidden, render_path, time_frames, photos],
    ids=lambda declared: declared.name,
)
def test_others_stop_within_a_picture(declared: Stage, stop_at: int, tmp_path: Path) -> None:
    scene = small.scene(tmp_path / "scene")
    container = small.splats(tmp_path / "container", "container")
    suspect = watermarks.stored_capture(tmp_path / "suspect", {"one.png": small.pictures(0)[0]})
    cases: dict[str, tuple[Parameters, dict[str, Artifact | tuple[Artifact, ...]]]] = {
        "add_grain": (AddGrainParameters(method="plain"), {"container": container, "cover": scene}),
        "find_grain": (FindGrainParameters(), {"before": container, "cover": scene, "pictures": suspect}),
        "evaluate": (EvaluateParameters(method="plain", lpips="none"), {"container": container, "cover": scene}),
        "render_hidden": (
            RenderHiddenParameters(name="statue", search_width=8),
            {"splats": small.splats(tmp_path / "splats"), "message": scene, "cover": scene},
        ),
        "render_path": (RenderPathParameters(method="plain", frames=4), {"container": container, "cover": scene}),
        "time_frames": (TimeFramesParameters(method="plain", frames=4), {"container": container, "cover": scene}),
        "photos": (PhotosParameters(folder=write_photos(tmp_path / "photos")), {}),
    }
    parameters, inputs = cases[declared.name]
    asking = Asking(stop_at)
    with pytest.raises(Interrupted):
        run_stage(declared, parameters, inputs, tmp_path / "out", services=asking.services())
    assert asking.looks == stop_at


def test_fine_tuning_stops_within_a_picture_that_it_marks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stages.finetune_rtws.train", None)  # which would look, too, but later
    asking = Asking(stop_at=2)
    with pytest.raises(Interrupted):
        run_stage(
            finetune_rtws,
            FinetuneRtwsParameters(method="plain"),
            inputs_of_rtws(tmp_path),
            tmp_path / "out",
            services=asking.services(),
        )
    assert asking.looks == 2
