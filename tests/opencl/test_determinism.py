"""The same bits on every run, for any number of threads, and on devices that need copies."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import pytest
import torch
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterOutput
from opencl.device import choose_device
from opencl.program import Schedule
from opencl.rasterizer import _rasterize_on, rasterize
from tests.opencl.runtimes import printed_with_threads
from tests.opencl.scenes import Scene, gradients, make_scene

GPU_ON_DEMAND = pytest.mark.parametrize("schedule", ["cpu", pytest.param("gpu", marks=pytest.mark.slow)])
"""On a GPU, `tests.benchmarks.nvidia` checks the same."""


def draw(backend: Backend, scene: Scene) -> tuple[RasterOutput, tuple[Tensor, ...]]:
    """A picture, and the leaves that it is drawn from."""
    leaves = tuple(tensor.clone().requires_grad_() for tensor in (*scene.gaussians, scene.background))
    return _rasterize_on(backend, *leaves[:5], *scene.camera, leaves[5], scene.settings), leaves


def digest(backend: Backend) -> str:
    """A hash of a picture and all its gradients."""
    scene = make_scene(count=2000, feature_dim=16, width=130, height=90, size=0.1, dtype=torch.float32)
    output, leaves = draw(backend, scene)
    hasher = hashlib.sha256()
    for tensor in (output.features, output.alphas, output.radii, output.means2d, *gradients(output, leaves)):
        hasher.update(tensor.detach().numpy().tobytes())
    return hasher.hexdigest()


def digest_on(schedule: Schedule) -> str:
    return digest(Backend(choose_device(), schedule=schedule))


@GPU_ON_DEMAND
def test_twenty_runs(schedule):
    backend = Backend(choose_device(), schedule=schedule)
    assert len({digest(backend) for _ in range(20)}) == 1


@GPU_ON_DEMAND
def test_any_number_of_threads(schedule, tmp_path):
    digests = set()
    for threads in ("1", "5"):
        environment = os.environ | {
            "POCL_MAX_PTHREAD_COUNT": threads,
            "OMP_NUM_THREADS": threads,
            "POCL_CACHE_DIR": str(tmp_path),  # the processes run one after the other, so they may share it
        }
        code = f"from tests.opencl.test_determinism import digest_on; print(digest_on({schedule!r}))"
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        digests.add(done.stdout.strip())
    digests.add(digest_on(schedule))
    assert len(digests) == 1


@pytest.mark.parametrize("schedule", ["cpu", "gpu"])
def test_copies_give_the_same_bits_as_shared_memory(schedule):
    scene = make_scene(count=100, feature_dim=3, dtype=torch.float32)
    results = []
    for shares_memory in (True, False):
        backend = Backend(choose_device(), schedule=schedule, shares_memory=shares_memory)
        output, leaves = draw(backend, scene)
        results.append((output.features, output.radii, *gradients(output, leaves)))
    assert all(torch.equal(one, other) for one, other in zip(*results, strict=True))


DEPTHS = """
import torch
from opencl.rasterizer import rasterize
from tests.opencl.scenes import make_scene
scene = make_scene(count=20011, feature_dim=1, width=260, height=180, size=0.01, dtype=torch.float32)
turned = torch.eye(4)
turned[:3, :3] = torch.linalg.matrix_exp(torch.tensor([[0.0, 0.1, 0.2], [-0.1, 0.0, 0.15], [-0.2, -0.15, 0.0]]))
pose, *camera = scene.camera
print(hash(rasterize(*scene.gaussians, turned @ pose, *camera, depth=True).depths.numpy().tobytes()))
"""


def test_depths_with_any_number_of_threads():
    """Matrix products of torch round differently with another number."""
    assert printed_with_threads(DEPTHS, 1) == printed_with_threads(DEPTHS, 3)


def test_depths_under_autocast():
    scene = make_scene(count=50, feature_dim=1, dtype=torch.float32)
    expected = rasterize(*scene.gaussians, *scene.camera, depth=True).depths
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = rasterize(*scene.gaussians, *scene.camera, depth=True).depths
    assert torch.equal(found, expected)
