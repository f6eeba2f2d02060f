"""The benchmark: its counts, its limits, and what the command prints."""

from __future__ import annotations

import json
import math
import os

import pytest
import torch

from opencl.__main__ import main
from opencl.backend import default_backend
from opencl.bench import command, implementations, measuring
from opencl.bench.counts import Counts, count_work
from opencl.bench.implementations import PEERS
from opencl.bench.limits import Limits, measure_limits
from opencl.bench.pairs import Footprints, Thresholds, contributing_pairs, repeat_each, tile_entries
from opencl.bench.processes import in_fresh_process
from opencl.bench.roofline import kernel_share
from opencl.bench.view import View
from opencl.bench.workloads import Box, Inputs, box_named
from opencl.contract import RasterSettings
from opencl.device import Device
from opencl.reference import project_reference
from tests.opencl.scenes import make_scene

TINY = "training-colours"


def test_workload_b_is_what_was_asked_for():
    inputs = box_named("b").inputs()
    view = inputs.views[0]
    projected = project_reference(*inputs.trained, *view.arguments, RasterSettings())
    assert (len(inputs.means), view.width, view.height, inputs.features.shape[1]) == (200_000, 1216, 800, 16)
    half_angle = torch.atan(view.width / 2 / view.intrinsics[0, 0])
    assert float(torch.rad2deg(2 * half_angle)) == pytest.approx(60, abs=0.01)
    radii = 3 * torch.linalg.eigvalsh(projected.covariances[projected.visible].double())[:, 1].sqrt()
    assert radii.mean() == pytest.approx(5.5, abs=0.1)
    assert radii.max() > 10 * radii.mean(), "a heavy tail"
    logits = torch.logit(inputs.opacities)
    assert float(logits.std()) == pytest.approx(2, abs=0.02)
    spread = inputs.scales.log() - inputs.scales.log().mean(dim=1, keepdim=True)
    assert float(spread.square().sum(dim=1).mean() / 2) ** 0.5 == pytest.approx(0.45, abs=0.01)
    assert torch.equal(inputs.means, box_named("B").inputs().means)


def scene_and_inputs(**changes):
    scene = make_scene(dtype=torch.float32, **({"count": 80, "width": 53, "height": 37} | changes))
    return scene, Inputs(*scene.gaussians, views=(View(*scene.camera),))


def counted_by_hand(scene):
    """Numbers of (tile, Gaussian) pairs, of (pixel, Gaussian) pairs in them, and of contributing ones, by pixel."""
    scene = scene.to(torch.float64)
    projected = project_reference(*scene.gaussians, *scene.camera, scene.settings)
    order = projected.visible.nonzero().squeeze(-1)
    order = order[torch.sort(projected.depths[order], stable=True).indices].tolist()
    met, contributing = set(), 0
    for row in range(scene.height):
        for column in range(scene.width):
            left = 1.0
            pixel = torch.tensor([column + 0.5, row + 0.5], dtype=torch.float64)
            for index in order:
                offset = pixel - projected.means[index]
                power = -0.5 * offset @ torch.linalg.inv(projected.covariances[index]) @ offset
                alpha = min(float(scene.opacities[index] * power.exp()), scene.settings.alpha_maximum)
                if alpha < scene.settings.alpha_minimum:
                    continue
                met.add((row // 16, column // 16, index))
                if left * (1 - alpha) < scene.settings.transmittance_minimum:
                    left = 0.0
                    continue
                left *= 1 - alpha
                contributing += left > 0
    pixels = sum(min(16, scene.height - 16 * row) * min(16, scene.width - 16 * column) for row, column, _ in met)
    return len(met), pixels, contributing


def test_counts_are_those_by_hand():
    scene, inputs = scene_and_inputs(count=25, width=35, height=21, size=0.5, opacity=(0.6, 1.0))
    counts = count_work(default_backend(), inputs, RasterSettings())
    assert (counts.tile_pairs, counts.evaluations, counts.contributing) == counted_by_hand(scene)
    assert counts.visible == int((scene.draw().radii > 0).sum())


def test_two_ways_of_counting_agree():
    scene, inputs = scene_and_inputs(count=300, size=0.4)
    projected = project_reference(*scene.gaussians, *scene.camera, scene.settings)
    inverse = torch.linalg.inv(projected.covariances)
    conics = torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], dim=-1)
    far = torch.full_like(projected.means, 1000.0)  # every Gaussian in every tile
    footprints = Footprints(projected.means, conics, scene.opacities, far, projected.depths, projected.visible)
    untouched = torch.ones(scene.width * scene.height)
    size = (scene.width, scene.height, 16)
    gaussians, pixels = contributing_pairs(footprints, *tile_entries(footprints, *size), *size, untouched, Thresholds())
    assert len(gaussians) == count_work(default_backend(), inputs, RasterSettings()).contributing
    assert (pixels.diff() >= 0).all()
    same_pixel = pixels.diff() == 0
    assert (projected.depths[gaussians].diff()[same_pixel] >= 0).all()


def test_counts_of_nothing():
    _, inputs = scene_and_inputs(count=0)
    counts = count_work(default_backend(), inputs, RasterSettings())
    assert (counts.gaussians, counts.visible, counts.tile_pairs, counts.contributing) == (0, 0, 0, 0)
    assert counts.mean_radius == 0


def test_repeat_each():
    owners, numbers = repeat_each(torch.tensor([2, 0, 3]))
    assert owners.tolist() == [0, 0, 2, 2, 2]
    assert numbers.tolist() == [0, 1, 0, 1, 2]


def test_limits_are_plausible():
    limits = measure_limits()
    assert 1e8 < limits.flops < 1e15
    assert 1e8 < limits.read_bytes < 1e14
    assert 1e8 < limits.write_bytes < 1e14


def test_a_kernel_at_the_limit_is_at_one():
    counts = Counts(1000, 900, 4000, 1_000_000, 200_000, 65_536, 16, 5.0)
    limits = Limits(flops=1e9, read_bytes=1e9, write_bytes=5e8)
    half = kernel_share("blend", 1.0, counts, limits)
    assert half.arithmetic is not None
    at_limit = kernel_share("blend", half.arithmetic, counts, limits)
    assert at_limit.arithmetic == pytest.approx(1)
    # Two operations per feature and pair: what M adds is counted exactly.
    more = kernel_share("blend", 1.0, Counts(1000, 900, 4000, 1_000_000, 200_000, 65_536, 17, 5.0), limits)
    assert more.arithmetic - half.arithmetic == pytest.approx(2 * 200_000 / 1e9)
    unknown = kernel_share("shuffle", 1.0, counts, limits)
    assert (unknown.seconds, unknown.arithmetic, unknown.bandwidth) == (1.0, None, None)


def test_fresh_processes():
    assert in_fresh_process(math.gcd, 12, 18) == 6
    with pytest.raises(RuntimeError, match=r"(?s)int failed in its process.*ValueError: invalid literal"):
        in_fresh_process(int, "nothing")
    with pytest.raises(RuntimeError, match="_exit: the process ended with exit status 3"):
        in_fresh_process(os._exit, 3)


@pytest.fixture
def no_peer_installed(monkeypatch):
    monkeypatch.setattr(implementations.importlib.util, "find_spec", lambda name: None)


@pytest.mark.slow  # measures in separate processes; the others here measure in this one
@pytest.mark.usefixtures("no_peer_installed")
def test_the_command_prints_tables(capsys):
    assert main(["bench", "--workload", TINY, "--repetitions", "1"]) == 0
    printed = capsys.readouterr().out
    assert "limits of the device" in printed
    assert "training-colours: 15,000 Gaussians" in printed
    for line in ("  ours", "  project", "  blend", "  blend_backward", "  outside kernels"):
        assert f"\n{line} " in printed
    for peer in PEERS:
        assert f"{peer.name} is not installed: pip install" in printed


def test_the_command_prints_json(capsys, monkeypatch):
    for module in (command, measuring):
        monkeypatch.setattr(module, "in_fresh_process", lambda function, *arguments: function(*arguments))
    assert main(["bench", "--workload", TINY, "--repetitions", "1", "--no-peers", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["missing"] == []
    (workload,) = result["workloads"]
    (ours,) = workload["measurements"]
    assert ours["implementation"] == "ours"
    assert ours["forward"]["seconds"] > 0
    assert ours["forward_backward"]["calls"] == 1
    assert ours["memory"]["forward"] <= ours["memory"]["forward_backward"]
    shares = {share["kernel"]: share for share in workload["kernels"]}
    assert all(0 < shares[name]["arithmetic"] < 1 for name in ("project", "blend", "blend_backward"))


@pytest.mark.parametrize(("shares_memory", "copies"), [(True, False), (False, True)])
def test_the_command_says_where_tensors_are_copied(shares_memory, copies, capsys, monkeypatch):
    for module in (command, measuring):
        monkeypatch.setattr(module, "in_fresh_process", lambda function, *arguments: function(*arguments))
    monkeypatch.setattr(Device, "shares_memory", shares_memory)
    monkeypatch.setattr(command, "measure_limits", lambda: Limits(1e11, 1e10, 1e10))
    monkeypatch.setattr(command, "box_named", lambda name: Box("few", 50, 40, 30, 3))
    options = ["bench", "--workload", "few", "--repetitions", "1", "--no-peers"]
    assert main(options) == 0
    printed = capsys.readouterr().out
    assert ("tensors of the CPU, by copies" in printed) == copies
    assert ("peak host memory" if copies else "peak memory") in printed
    assert main([*options, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["copies"] == copies


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--workload", "C"], "--workload: found 'C', expected one of A, B"),
        (["--splats", "/nowhere/truck.splat"], "--splats: /nowhere/truck.splat is no file"),
        (["--repetitions", "0"], "--repetitions: found 0, expected 1 or more"),
        (["--device", "no such device"], "found 'no such device', expected an index"),
    ],
)
def test_the_command_says_what_is_wrong(arguments, message, capsys, monkeypatch):
    monkeypatch.setenv("GS_HIDER_DEVICE", "")  # so that it is restored afterwards
    assert main(["bench", *arguments]) == 2
    assert message in capsys.readouterr().err
