"""The schedules, and the OpenCL runtimes that tests use besides the default: Debian's PoCL, PyPI's, and Oclgrind.

Tests use this process's default device. Another runtime needs another process: which drivers and libraries are loaded
is decided when a process starts.
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
"""All schedules, for tests that run on each of them."""

ROOT = Path(__file__).parents[2]
DEBIAN_POCL = Path(sys.prefix) / "debian-pocl"
"""Where `make test` unpacks Debian's package."""
OCLGRIND = Path(sys.prefix) / "oclgrind"
"""Where `make test` installs Oclgrind: beside pyopencl, it would be the first device of every program."""


@functools.cache
def backend_of(schedule: Schedule, device: str | None = None) -> Backend:
    """The backend with a schedule, on the default device or the one that `device` names."""
    return Backend(choose_device(device), schedule=schedule)


def draw_on(backend: Backend, scene: Scene) -> RasterOutput:
    """The scene's picture, drawn by a backend without the checks of `rasterize`."""
    return _rasterize_on(backend, *scene.gaussians, *scene.camera, scene.background, scene.settings)


def draw_with_gradients(backend: Backend, scene: Scene, **wishes: bool) -> tuple[RasterOutput, tuple[Tensor, ...]]:
    """The scene's picture, and the gradients of means, quats, scales, opacities, features, background and means2d.

    `wishes` are options of `rasterize`: `depth`, `absolute_gradients`, `count_pixels`.
    """
    leaves = tuple(tensor.clone().requires_grad_() for tensor in (*scene.gaussians, scene.background))
    output = _rasterize_on(backend, *leaves[:5], *scene.camera, leaves[5], scene.settings, **wishes)
    return output, gradients(output, leaves)


def bits(tensor: Tensor) -> bytes:
    """The bytes of a tensor, to compare two to the last bit, including NaN and the sign of zero."""
    return tensor.detach().contiguous().numpy().tobytes()


def _libraries_of(root: Path) -> list[Path]:
    return [*root.glob("usr/lib/*-linux-*"), *root.glob("usr/lib/llvm-*/lib")]


def debian_pocl_environment(vendors: Path) -> dict[str, str] | None:
    """The environment in which Debian's PoCL is a device, too; None if the package is not unpacked.

    `vendors` is an empty directory for the file that names it to the OpenCL loader.
    """
    drivers = sorted(DEBIAN_POCL.glob("usr/lib/*/libpocl.so.*"))
    if not drivers:
        return None
    (vendors / "pocl.icd").write_text(f"{drivers[0]}\n")
    paths = [str(path) for path in _libraries_of(DEBIAN_POCL)] + [os.environ.get("LD_LIBRARY_PATH", "")]
    return os.environ | {"OCL_ICD_VENDORS": str(vendors), "LD_LIBRARY_PATH": ":".join(filter(None, paths))}


def oclgrind_environment(vendors: Path) -> dict[str, str] | None:
    """The environment in which Oclgrind is the device; None if it is not installed."""
    drivers = sorted(OCLGRIND.glob("pyopencl/.libs/liboclgrind-rt-icd*.so"))
    if not drivers:
        return None
    (vendors / "oclgrind.icd").write_text(f"{drivers[0]}\n")
    return os.environ | {"OCL_ICD_VENDORS": str(vendors), DEVICE_VARIABLE: "Oclgrind"}


def run_module(environment: dict[str, str], *arguments: str, timeout: float = 3600) -> subprocess.CompletedProcess[str]:
    """Run `python -m arguments…` in the repository's root. The caller must check the exit status.

    `timeout` is in seconds, in case the module hangs.
    """
    command = [sys.executable, "-m", *arguments]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=timeout)


def printed_with_threads(script: str, threads: int) -> str:
    """What a script prints with so many threads of OpenCL and torch; `hash` is the same in all these processes."""
    environment = os.environ | {"POCL_MAX_PTHREAD_COUNT": str(threads), "PYTHONHASHSEED": "0"}
    environment.pop("POCL_CACHE_DIR", None)  # belongs to this process alone
    command = [sys.executable, "-c", f"import torch\ntorch.set_num_threads({threads})\n{script}"]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True).stdout


def dtype_of(name: str) -> torch.dtype:
    """The type that a command line names `float32` or `float64`."""
    return {"float32": torch.float32, "float64": torch.float64}[name]
