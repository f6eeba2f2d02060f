"""Fixtures of the rasterizer's tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import opencl.rasterizer
from opencl.backend import Backend
from opencl.device import choose_device


@pytest.fixture(scope="module", params=["cpu", "gpu"])
def both_schedules(request: pytest.FixtureRequest) -> Iterator[Backend]:
    """Runs a module's tests once with the kernels for CPUs and once with those for GPUs, on the same device."""
    backend = Backend(choose_device(), schedule=request.param)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(opencl.rasterizer, "backend_for", lambda tensor_device: backend)
        yield backend
