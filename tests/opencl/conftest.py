"""Fixtures of the rasterizer's tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import opencl.rasterizer
from opencl.backend import BUILD_OPTIONS, Backend
from opencl.device import choose_device


@pytest.fixture(scope="session", autouse=True)
def gpu_kernels_as_they_are_written() -> Iterator[None]:
    """Do not optimise GPU kernels on CPUs, where only tests run them: that takes 4 to 9 times as long as compiling."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(BUILD_OPTIONS, "gpu", (*BUILD_OPTIONS["gpu"], "-cl-opt-disable"))
        yield


@pytest.fixture(scope="module", params=["cpu", "gpu"])
def both_schedules(request: pytest.FixtureRequest) -> Iterator[Backend]:
    """Runs a module's tests once with the kernels for CPUs and once with those for GPUs, on the same device."""
    backend = Backend(choose_device(), schedule=request.param)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(opencl.rasterizer, "backend_for", lambda tensor_device: backend)
        yield backend
