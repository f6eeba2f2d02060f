"""Schedules and OpenCL runtimes that the tests run on beside the default: Debian's PoCL, PyPI's, and Oclgrind.

The tests' device is this process's default. Another runtime needs another process: which drivers and libraries are
loaded is decided when a process starts.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from pathlib import Path

import torch
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterOutput
from opencl.device import DEVICE_VARIABLE, choose_device
from opencl.program import Schedule
from opencl.rasterizer import _rasterize_on
from tests.opencl.scenes import Scene, gradients

SCHEDULES: tuple[Schedule, ...] = ("cpu", "gpu")
"""Every schedule that draws: each test of this folder that takes one runs on all of them."""

ROOT = Path(__file__).parents[2]
DEBIAN_POCL = Path(sys.prefix) / "debian-pocl"
"""Where `make test` unpacks Debian's package."""
OCLGRIND = Path(sys.prefix) / "oclgrind"
"""Where `make test` installs Oclgrind: beside pyopencl it would be every program's first device."""


@functools.cache
def backend_of(schedule: Schedule, device: str | None = None) -> Backend:
    """The default device, or the one that `device` names, with a schedule."""
    return Backend(choose_device(device), schedule=schedule)


def draw_on(backend: Backend, scene: Scene) -> RasterOutput:
    """The scene's picture without the checks of `rasterize`, on a backend."""
    return _rasterize_on(backend, *scene.gaussians, *scene.camera, scene.background, scene.settings)


def draw_with_gradients(backend: Backend, scene: Scene, **wishes: bool) -> tuple[RasterOutput, tuple[Tensor, ...]]:
    """The scene's picture, and the gradients of means, quats, scales, opacities, features, background and means2d.

    `wishes` are `rasterize`'s: `depth`, `absolute_gradients`, `count_pixels`.
    """
    leaves = tuple(tensor.clone().requires_grad_() for tensor in (*scene.gaussians, scene.background))
    output = _rasterize_on(backend, *leaves[:5], *scene.camera, leaves[5], scene.settings, **wishes)
    return output, gradients(output, leaves)


def bits(tensor: Tensor) -> bytes:
    """What two tensors share when they are the same to the last bit, NaN and the zero's sign included."""
    return tensor.detach().contiguous().numpy().tobytes()


def _libraries_of(root: Path) -> list[Path]:
    return [*root.glob("usr/lib/*-linux-*"), *root.glob("usr/lib/llvm-*/lib")]


def debian_pocl_environment(vendors: Path) -> dict[str, str] | None:
    """The environment in which Debian's PoCL is a device too; None where the package is not unpacked.

    `vendors` is an empty directory for the file that tells the OpenCL loader of it.
    """
    drivers = sorted(DEBIAN_POCL.glob("usr/lib/*/libpocl.so.*"))
    if not drivers:
        return None
    (vendors / "pocl.icd").write_text(f"{drivers[0]}\n")
    paths = [str(path) for path in _libraries_of(DEBIAN_POCL)] + [os.environ.get("LD_LIBRARY_PATH", "")]
    return os.environ | {"OCL_ICD_VENDORS": str(vendors), "LD_LIBRARY_PATH": ":".join(filter(None, paths))}


def oclgrind_environment(vendors: Path) -> dict[str, str] | None:
    """The environment in which Oclgrind is the device; None where it is not installed."""
    drivers = sorted(OCLGRIND.glob("pyopencl/.libs/liboclgrind-rt-icd*.so"))
    if not drivers:
        return None
    (vendors / "oclgrind.icd").write_text(f"{drivers[0]}\n")
    return os.environ | {"OCL_ICD_VENDORS": str(vendors), DEVICE_VARIABLE: "Oclgrind"}


def run_module(environment: dict[str, str], *arguments: str, timeout: float = 3600) -> subprocess.CompletedProcess[str]:
    """`python -m arguments…` from the repository's root; its exit status is the caller's to judge.

    `timeout` is for what hangs, in seconds.
    """
    command = [sys.executable, "-m", *arguments]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=timeout)


def printed_with_threads(script: str, threads: int) -> str:
    """What a script prints in a process whose OpenCL and torch have so many threads; `hash` is the same in each."""
    environment = os.environ | {"POCL_MAX_PTHREAD_COUNT": str(threads), "PYTHONHASHSEED": "0"}
    environment.pop("POCL_CACHE_DIR", None)  # of this process alone
    command = [sys.executable, "-c", f"import torch\ntorch.set_num_threads({threads})\n{script}"]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True).stdout


def dtype_of(name: str) -> torch.dtype:
    """`float32` or `float64` by name, as command lines carry it."""
    return {"float32": torch.float32, "float64": torch.float64}[name]
