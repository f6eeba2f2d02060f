"""Uninitialised memory never affects the results of kernels: they have the same bits, whatever it holds."""

from __future__ import annotations

import pytest
import torch

import opencl.memory
from tests.opencl.runtimes import SCHEDULES, backend_of, bits, draw_with_gradients
from tests.opencl.scenes import make_scene


@pytest.fixture
def filled(monkeypatch):
    """A function that makes torch fill new memory with one byte, so that reads before writes show."""

    def fill(byte):
        monkeypatch.undo()
        for owner, name in (
            (opencl.memory, "empty"),
            (torch, "empty"),
            (torch, "empty_like"),
            (torch.Tensor, "new_empty"),
        ):
            monkeypatch.setattr(owner, name, _filling(getattr(owner, name), byte))

    return fill


def _filling(make, byte):
    def made(*arguments, **options):
        tensor = make(*arguments, **options)
        if tensor.numel() and tensor.is_contiguous():
            tensor.detach().view(-1).view(torch.uint8).fill_(byte)
        return tensor

    return made


def test_the_filling_reaches_new_memory(filled):
    filled(255)
    assert torch.empty(3).isnan().all()
    assert torch.zeros(2).new_empty(3, dtype=torch.int32).tolist() == [-1, -1, -1]


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("feature_dim", [3, 17, 70])
def test_no_result_depends_on_what_memory_held(filled, schedule, feature_dim):
    scene = make_scene(150, feature_dim, 61, 35, size=0.3, opacity=(0.05, 1.0), dtype=torch.float32)
    scene.means[::5] *= -1  # some are out of view: their rows are never drawn
    results = []
    for byte in (0, 255, 127, 1):
        filled(byte)
        output, found = draw_with_gradients(backend_of(schedule), scene)
        tensors = (output.features, output.alphas, output.radii, output.means2d, *found)
        results.append([bits(tensor) for tensor in tensors])
        assert all(tensor.isfinite().all() for tensor in tensors)
    assert all(result == results[0] for result in results)
