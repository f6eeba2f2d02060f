"""The rasterizer on an NVIDIA GPU, in one run: devices, the same picture as on the CPU, and its speed beside gsplat's.

NOT YET RUN ON A GPU: written where none was at hand.

    pip install 'pyopencl[pocl]' jaxtyping filelock         (torch with CUDA is there; gsplat is compared if it is, too)
    python -m tests.benchmarks.nvidia

A missing ICD file is made in a temporary directory, for this run alone. The exit status is 0 where every comparison
holds, 1 where one does not, 2 where the GPU cannot be reached.
"""

from __future__ import annotations

import ctypes
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:  # what asks for OpenCL's platforms is imported once the ICD file is there
    from opencl.bench.workloads import Inputs
    from opencl.cuda import CudaBackend

VENDORS = Path("/etc/OpenCL/vendors")
LIBRARY = "libnvidia-opencl.so.1"
REPETITIONS = 20


def provide_icd() -> None:
    """Name NVIDIA's OpenCL to the loader, beside what is installed. To be called before any platform is asked for."""
    installed = list(VENDORS.glob("*.icd"))
    if os.environ.get("OCL_ICD_VENDORS") or any("nvidia" in path.read_text().lower() for path in installed):
        return
    try:
        ctypes.CDLL(LIBRARY)
    except OSError as error:
        print(f"{LIBRARY}: {error}")
        return
    folder = Path(tempfile.mkdtemp(prefix="opencl-vendors-"))
    for path in installed:
        (folder / path.name).write_text(path.read_text())
    (folder / "nvidia.icd").write_text(LIBRARY + "\n")
    os.environ["OCL_ICD_VENDORS"] = str(folder)
    print(f"no ICD file of NVIDIA's: {folder}/nvidia.icd made for this run")


def main() -> int:
    provide_icd()
    from opencl.__main__ import main as opencl_command
    from opencl.backend import default_backend
    from opencl.cuda import CudaBackend
    from opencl.routes import backend_for
    from tests.benchmarks import nvidia_checks

    print(f"Python {sys.version.split()[0]}, torch {torch.__version__}, CUDA {torch.version.cuda}")
    opencl_command(["devices"])
    if not torch.cuda.is_available():
        print("torch sees no CUDA device")
        return 2
    print(torch.cuda.get_device_name(), f"driver's compute capability {torch.cuda.get_device_capability()}")
    backend = backend_for(torch.device("cuda", 0))
    if not isinstance(backend, CudaBackend):
        print(f"CUDA tensors would be drawn by {backend.device.describe()}, with copies: see what is missing above")
        return 2
    if not default_backend().device.is_cpu:
        print(f"nothing to compare with: CPU tensors would be drawn by {default_backend().device.describe()}")
        return 2
    holds = [nvidia_checks.check_against_cpu(), nvidia_checks.check_large(backend)]
    holds += [nvidia_checks.check_runs(), nvidia_checks.check_streams()]
    time_workload()
    time_copies(backend)
    print_kernels(backend)
    return 0 if all(holds) else 1


def median_milliseconds(work: Callable[[], object]) -> float:
    for _ in range(5):
        work()
    seconds = []
    for _ in range(REPETITIONS):
        torch.cuda.synchronize()
        start = time.perf_counter()
        work()
        torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds) * 1e3


def workload_b() -> Inputs:
    from opencl.bench.workloads import box_named

    return box_named("B").inputs()


def time_workload() -> None:
    """Forward, and forward with backward, of workload B; gsplat's with the same settings where it is installed."""
    from opencl.contract import RasterSettings
    from opencl.rasterizer import rasterize

    inputs = workload_b()
    view = inputs.views[0]
    leaves = [tensor.cuda().requires_grad_() for tensor in inputs.trained]
    feature_dim = inputs.features.shape[1]
    gradient = torch.rand(view.height, view.width, feature_dim, device="cuda")
    settings = RasterSettings(near=0.01, alpha_maximum=0.999, radius_sigmas=3.33, clamp_about="principal_point")

    def ours() -> Tensor:
        return rasterize(*leaves, *view.arguments, settings=settings).features

    drawers: dict[str, Callable[[], Tensor]] = {"ours": ours}
    try:
        import gsplat
    except ImportError:
        print("gsplat is not installed: pip install gsplat, to compare")
    else:
        means, quats, scales, opacities, features = leaves
        poses, intrinsics = view.world_to_camera[None].cuda(), view.intrinsics[None].cuda()

        def theirs() -> Tensor:
            arguments = (means, quats, scales, opacities, features, poses, intrinsics, view.width, view.height)
            return gsplat.rasterization(*arguments, near_plane=settings.near, packed=False)[0][0]

        drawers[f"gsplat {gsplat.__version__}"] = theirs

    def without_gradients(draw: Callable[[], Tensor]) -> None:
        with torch.no_grad():
            draw()

    print(f"workload B: {len(inputs.means)} Gaussians, {view.width} x {view.height}, M={feature_dim}, ms, medians")
    for name, draw in drawers.items():
        forward = median_milliseconds(lambda draw=draw: without_gradients(draw))
        both = median_milliseconds(lambda draw=draw: draw().backward(gradient))
        print(f"  {name:16} forward {forward:8.3f}, forward + backward {both:8.3f}", flush=True)
    if len(drawers) == 2:
        with torch.no_grad():
            one, other = (draw() for draw in drawers.values())
        print(f"  pictures: {float((one - other).abs().mean()):.1e} apart on average")


def time_copies(backend: CudaBackend) -> None:
    """The same GPU for tensors of the CPU, through pinned memory."""
    from opencl.backend import Backend
    from opencl.rasterizer import RasterSettings, _rasterize_on

    inputs = workload_b()
    view = inputs.views[0]
    leaves = [tensor.requires_grad_() for tensor in inputs.trained]
    feature_dim = inputs.features.shape[1]
    gradient = torch.rand(view.height, view.width, feature_dim)
    staged = Backend(backend.device)

    def draw() -> None:
        output = _rasterize_on(staged, *leaves, *view.arguments, torch.zeros(feature_dim), RasterSettings())
        output.features.backward(gradient)

    print(f"  ours, CPU tensors, copied: forward + backward {median_milliseconds(draw):8.3f}")


def print_kernels(backend: CudaBackend) -> None:
    """Where a forward and backward pass of workload B spends the GPU's time, and what each kernel takes of it."""
    from opencl.cuda import CudaBackend
    from opencl.rasterizer import RasterSettings, _rasterize_on

    profiled = CudaBackend(backend.device, backend.driver, backend.tensor_device, profile=True)
    inputs = workload_b()
    view = inputs.views[0]
    leaves = [tensor.cuda().requires_grad_() for tensor in inputs.trained]
    background = torch.zeros(inputs.features.shape[1], device="cuda")
    for _ in range(3):
        profiled.profiled = []
        output = _rasterize_on(profiled, *leaves, *view.arguments, background, RasterSettings())
        output.features.backward(torch.ones_like(output.features))
    totals: dict[str, list[int]] = {}
    for kernel, event in profiled.profiled:
        totals.setdefault(kernel, []).append(event.profile.end - event.profile.start)
    resources = profiled.resources()
    for kernel, times in sorted(totals.items(), key=lambda one: -sum(one[1])):
        taken = f"{resources[kernel].registers:3} registers, {resources[kernel].private_bytes:5} bytes beside them"
        print(f"  {kernel:20} {len(times):3} launches {sum(times) / 1e6:8.3f} ms, a work-item: {taken}")


if __name__ == "__main__":
    sys.exit(main())
