"""Frames are timed camera after camera until they are rendered; the median leaves out the warm-up."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch

from stages.hiding.methods.gs_hider import GSHider
from stages.hiding.rendering import Rendering
from stages.imaging.metric_table import read_rows
from stages.time_frames import TimeFramesParameters, median_seconds, time_frames, wait_for
from tests.running import run_stage
from tests.stages.small import scene
from tests.stages.test_steganalysis import container


@pytest.mark.parametrize("is_cuda", [True, False])
def test_a_gpu_is_waited_for(monkeypatch: pytest.MonkeyPatch, is_cuda: bool) -> None:
    waited: list[Any] = []
    monkeypatch.setattr(torch.cuda, "synchronize", waited.append)
    device = torch.device("cuda", 0) if is_cuda else torch.device("cpu")
    feature_map = SimpleNamespace(is_cuda=is_cuda, device=device)
    wait_for(cast(Rendering, SimpleNamespace(feature_map=feature_map)))
    assert waited == ([device] if is_cuda else [])


def test_the_median_is_of_the_frames_after_the_warm_up_one_camera_after_the_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lasts = {"a": 1.0, "b": 5.0, "c": 2.0}
    clock, seen = [0.0], list[str]()

    def draw(camera: str) -> SimpleNamespace:
        seen.append(camera)
        clock[0] += 100.0 if len(seen) <= 2 else lasts[camera]
        return SimpleNamespace(feature_map=SimpleNamespace(is_cuda=False))

    monkeypatch.setattr("stages.time_frames.time.perf_counter", lambda: clock[0])
    looked = list[None]()
    median = median_seconds(cast(Any, draw), cast(Any, list(lasts)), 2, 4, lambda: looked.append(None))
    assert seen == ["a", "b", "c", "a", "b", "c"]
    assert median == 2.0, "of 2, 1, 5 and 2"
    assert len(looked) == 6


def test_a_frame_is_decoded_and_a_feature_map_is_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the three timed frames and the one of the warm-up are decoded."""
    frames: list[object] = []
    render = GSHider.render

    def watched(self: GSHider, *given: Any, **named: Any) -> Rendering:
        frames.append(given)
        return render(self, *given, **named)

    monkeypatch.setattr(GSHider, "render", watched)
    given = {"container": container(tmp_path / "container"), "cover": scene(tmp_path / "cover")}
    made = run_stage(time_frames, TimeFramesParameters(frames=3, warmup=1, threads=1), given, tmp_path / "out")
    rows = {row.quantity: row.value for row in read_rows(made["timings"])}
    assert rows.keys() == {"seconds_per_frame", "seconds_per_feature_map"}
    assert all(value > 0 for value in rows.values())
    assert len(frames) == 4, "of feature maps, none is decoded"
