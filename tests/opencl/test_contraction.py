"""On the GPU schedule, the light in a pixel has the same bits, forward and backward, whatever a compiler contracts."""

from __future__ import annotations

from unittest import mock

import torch
from torch import Tensor

from opencl.backend import Backend
from opencl.device import choose_device
from opencl.program import ProgramKey
from opencl.rasterizer import _rasterize_on
from tests.opencl.runtimes import backend_of, bits
from tests.opencl.scenes import Scene, make_scene


def light(scene: Scene, backend: Backend) -> tuple[Tensor, Tensor]:
    """The alphas from the forward kernel, and the sum of the light that passes through from the backward kernel."""
    background = scene.background.clone().requires_grad_()
    output = _rasterize_on(backend, *scene.gaussians, *scene.camera, background, scene.settings)
    output.features.sum().backward()
    assert background.grad is not None
    return output.alphas, background.grad


def test_no_light_depends_on_what_a_compiler_contracts() -> None:
    """It may contract one kernel and not the other. A Gaussian that only one of them draws spoils those behind it."""
    scene = make_scene(count=200, feature_dim=1, width=64, height=48, dtype=torch.float32)
    usual = light(scene, backend_of("gpu"))
    with mock.patch.object(ProgramKey, "needs_exact_rounding", True):  # so that nothing is contracted
        as_written = light(scene, Backend(choose_device(), schedule="gpu"))
    for one, other in zip(usual, as_written, strict=True):
        assert bits(one) == bits(other)
