"""The comparisons of `tests.benchmarks.nvidia`, on the CPU: they accept correct results, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from opencl.backend import Backend, default_backend
from opencl.device import choose_device
from tests.benchmarks import nvidia_checks
from tests.benchmarks.nvidia_checks import (
    check_against_cpu,
    check_harmonics,
    check_large,
    check_lists,
    check_runs,
    check_similarities,
    drawn_by,
    drawn_by_cpu,
    faults_of,
    large_scene,
    largest_difference,
    relative_error,
    share_apart,
)
from tests.opencl.runtimes import backend_of
from tests.opencl.scenes import make_scene

FEW = ((1, 1), (3, 60), (3, 0))
GRADIENTS = range(3, 10)
"""Places of the gradients, means to means2d, after alphas, radii and centres."""


def spoilt(change, *, place=None, dtype=None):
    """Draws on the CPU with a change to the picture, or to the other tensor at `place`; of one dtype only, if given."""

    def draw(scene):
        drawing = drawn_by_cpu(scene)
        if len(scene.means) == 0 or dtype not in (None, scene.means.dtype):
            return drawing
        change((drawing.picture if place is None else drawing.others[place]).view(-1))
        return drawing

    return draw


def put_nan(values):
    values[-1] = torch.nan


def test_the_same_holds():
    assert check_against_cpu(drawn_by_cpu, FEW)
    assert check_runs(drawn_by_cpu)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("place", [None, 0, 2, *GRADIENTS])
def test_a_single_nan_fails(place, dtype):
    assert not check_against_cpu(spoilt(put_nan, place=place, dtype=dtype), FEW[1:])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("place", [0, 1, 2, *GRADIENTS])
def test_what_is_not_the_picture_is_compared_too(place, dtype):
    assert not check_against_cpu(spoilt(lambda values: values.mul_(2), place=place, dtype=dtype), FEW[1:])


def test_pixels_apart_fail():
    assert not check_against_cpu(spoilt(lambda values: values[:100].add_(1e-3), dtype=torch.float32), FEW[1:])


@pytest.mark.parametrize("measure", [largest_difference, relative_error, share_apart])
@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_nothing_is_near_what_is_not_finite(measure, value):
    good = torch.ones(4, 3)
    bad = good.clone()
    bad[2, 1] = value
    assert measure(good, good) == 0
    assert measure(good, bad) == measure(bad, good) == measure(bad, bad) == torch.inf


def test_runs_that_differ_or_are_nan_fail():
    turns = iter(range(100))
    assert not check_runs(spoilt(lambda values: values.add_(next(turns))))
    assert not check_runs(spoilt(put_nan, place=3))


def test_lists_of_the_gpu_schedule_hold(capsys):
    assert check_large(backend_of("gpu"), drawn_by_cpu, count=3000)
    assert capsys.readouterr().out.count("lists of 3000 Gaussians") == 2


def test_wrong_lists_fail(monkeypatch):
    scene = large_scene(300, torch.float64)
    scene_lists = nvidia_checks._lists_on

    def shifted(backend, *given):
        lists = scene_lists(backend, *given)
        return lists if backend is default_backend() else replace(lists, starts=lists.starts.clamp(max=7))

    monkeypatch.setattr(nvidia_checks, "_lists_on", shifted)
    assert not check_lists(backend_of("gpu"), scene)


@pytest.fixture(scope="module")
def copying():
    """A backend that draws CPU tensors by copies, as on a GPU."""
    return Backend(choose_device(), schedule="gpu", shares_memory=False)


def test_what_is_drawn_by_copies_holds(copying):
    assert check_large(copying, drawn_by(copying), count=300)


def test_similarities_and_harmonics_hold(copying, capsys):
    for backend in (copying, backend_of("gpu")):
        assert check_similarities(backend)
        assert check_harmonics(backend)
    assert capsys.readouterr().out.count("holds") == 28


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("change", [put_nan, lambda values: values.mul_(1.01)])
@pytest.mark.parametrize("name", ["similarity", "colors"])
def test_wrong_similarities_and_harmonics_fail(name, change, dtype, copying, monkeypatch):
    compute = getattr(nvidia_checks, name)

    def wrong(*arguments):
        found = compute(*arguments)
        if arguments[-2:] == (copying, dtype):
            change(found[-1].view(-1)[-100:])
        return found

    monkeypatch.setattr(nvidia_checks, name, wrong)
    monkeypatch.setattr(nvidia_checks, "HARMONICS", ((3, 15, 100),))
    assert not (check_similarities if name == "similarity" else check_harmonics)(copying)


def swap(values):
    values[[0, 1]] = values[[1, 0]]


@pytest.mark.parametrize(
    ("name", "change", "fault"),
    [
        ("slots", lambda slots: slots[:2].fill_(0), "slots are no permutation"),
        ("slots", swap, "do not lie side by side"),
        ("entries", lambda entries: entries[:1].fill_(-1), "no Gaussian's"),
        ("entries", lambda entries: entries[:1].fill_(10**6), "no Gaussian's"),
        ("starts", lambda starts: starts[-1:].sub_(1), "counted and not found again"),
        ("starts", lambda starts: starts[1:2].fill_(10**6), "do not follow"),
        ("tile_counts", lambda counts: counts[5:6].add_(1), "more or fewer entries"),
    ],
)
def test_lists_that_contradict_themselves_are_found(name, change, fault):
    scene = make_scene(count=50, feature_dim=1, width=150, height=90, dtype=torch.float32)
    camera = nvidia_checks.pack_camera(*scene.camera, scene.settings)
    backend = backend_of("gpu")
    size = (scene.width, scene.height)
    projected = nvidia_checks.Project.apply(backend, scene.settings, camera, size, *scene.gaussians)[1:]
    lists = nvidia_checks._lists_on(backend, scene, projected)
    assert faults_of(lists) == []
    change(getattr(lists, name))
    assert any(fault in one for one in faults_of(lists))
