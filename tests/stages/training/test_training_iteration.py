"""`tests.benchmarks.training_iteration` measures on the device that stages use, and names it."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from opencl.backend import default_backend
from tests.benchmarks import training_iteration
from tests.stages import small


def test_a_table_of_each_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.setattr(training_iteration, "keep_freed_memory", lambda: None)
    monkeypatch.setattr(torch, "set_num_threads", lambda count: None)
    small.scene(tmp_path / "scene")
    small.splats(tmp_path / "splats")
    small.message_views(tmp_path / "views")
    folders = [str(tmp_path / name) for name in ("scene", "splats", "views")]
    training_iteration.main(training_iteration.parser().parse_args(["homogeneous", *folders, "--iterations", "2"]))
    printed = capsys.readouterr().out
    assert printed.startswith(default_backend().device.describe())
    assert "homogeneous, 60 Gaussians" in printed
    assert "decoders" in printed
    assert "checkpoints:" in printed


def test_a_gpu_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    waited = []
    monkeypatch.setattr(torch.cuda, "synchronize", waited.append)
    monkeypatch.setattr(training_iteration.time, "perf_counter", lambda: float(len(waited)))
    clock = training_iteration.clock_of(torch.device("cuda", 0))
    assert [clock(), clock()] == [1.0, 2.0]
    assert waited == [torch.device("cuda", 0)] * 2
    assert training_iteration.clock_of(torch.device("cpu")) is training_iteration.time.process_time
