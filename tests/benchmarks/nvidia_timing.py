"""The measurements of `tests.benchmarks.nvidia`: drawing (beside gsplat, by copies, kernel by kernel) and decoding."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Collection

import torch
from torch import Tensor

from opencl.backend import Backend
from opencl.bench.view import View
from opencl.bench.workloads import Box, Inputs
from opencl.cuda import CudaBackend
from opencl.device import Device
from opencl.rasterizer import RasterSettings, _rasterize_on, rasterize

REPETITIONS = 20


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


def leaves_on(device: torch.device, inputs: Inputs) -> list[Tensor]:
    """The trained tensors of a workload, on a torch device."""
    return [tensor.to(device, copy=True).requires_grad_() for tensor in inputs.trained]


def time_workload(device: torch.device, inputs: Inputs) -> None:
    """Time forward, and forward with backward; also gsplat's, with the same settings, if it is installed."""
    view = inputs.views[0]
    leaves = leaves_on(device, inputs)
    feature_dim = inputs.features.shape[1]
    gradient = torch.rand(view.height, view.width, feature_dim, device=device)
    settings = RasterSettings(near=0.01, alpha_maximum=0.999, radius_sigmas=3.33, clamp_about="principal_point")

    def ours() -> Tensor:
        return rasterize(*leaves, *view.arguments, settings=settings).features

    drawers: dict[str, Callable[[], Tensor]] = {"ours": ours}
    try:
        drawers["gsplat"] = gsplat_drawer(leaves, view, settings.near)
    except Exception as error:  # not installed, or not compiled for this GPU: ours is timed all the same
        print(f"gsplat (pip install gsplat) draws nothing to compare with: {error!r}")

    def without_gradients(draw: Callable[[], Tensor]) -> None:
        with torch.no_grad():
            draw()

    print(f"{len(inputs.means)} Gaussians, {view.width} x {view.height}, M={feature_dim}, ms, medians")
    for name, draw in drawers.items():
        forward = median_milliseconds(lambda draw=draw: without_gradients(draw))
        both = median_milliseconds(lambda draw=draw: draw().backward(gradient))
        print(f"  {name:16} forward {forward:8.3f}, forward + backward {both:8.3f}", flush=True)
    if len(drawers) == 2:
        with torch.no_grad():
            one, other = (draw() for draw in drawers.values())
        print(f"  pictures: {float((one - other).abs().mean()):.1e} apart on average")


def time_decoding(device: torch.device, box: Box) -> None:
    """Time what an iteration does besides drawing: both decoders, and the similarities of both pictures."""
    from stages.hiding.decoders import PRECISIONS, Decoder, Precision, decode
    from stages.imaging.ssim import ssim

    of_methods = {
        "GS-Hider": [Decoder(box.feature_dim, 3).to(device) for _ in range(2)],
        "homogeneous": [Decoder(box.feature_dim, 3, width=32, kernel_size=1).to(device) for _ in range(2)],
    }
    feature_map = torch.rand(box.height, box.width, box.feature_dim, device=device, requires_grad=True)
    truth = torch.rand(box.height, box.width, 3, device=device)

    def decoded(decoders: list[Decoder], precision: Precision) -> None:
        sum(decode(decoder, feature_map, precision).sum() for decoder in decoders).backward()

    def compared() -> None:
        picture = truth.flip(0).requires_grad_()
        (ssim(picture, truth) + ssim(picture, truth)).backward()

    print(f"{box.width} x {box.height}, M={box.feature_dim}, forward + backward of two, ms, medians")
    for method, decoders in of_methods.items():
        for name, precision in PRECISIONS.items():
            taken = median_milliseconds(lambda pair=decoders, precision=precision: decoded(pair, precision))
            print(f"  decoders of {method}, {name:12} {taken:8.3f}")
    print(f"  similarities           {median_milliseconds(compared):8.3f}", flush=True)


def gsplat_drawer(leaves: list[Tensor], view: View, near: float) -> Callable[[], Tensor]:
    """A function that draws with gsplat, after a first drawing. Raises whatever gsplat raises if it cannot draw."""
    import gsplat

    means, quats, scales, opacities, features = leaves
    poses, intrinsics = view.world_to_camera[None].to(means.device), view.intrinsics[None].to(means.device)

    def draw() -> Tensor:
        arguments = (means, quats, scales, opacities, features, poses, intrinsics, view.width, view.height)
        return gsplat.rasterization(*arguments, near_plane=near, packed=False)[0][0]

    draw()
    print(f"gsplat {gsplat.__version__}")
    return draw


def time_copies(device: Device, inputs: Inputs) -> None:
    """Time the same GPU for CPU tensors, copied through pinned memory."""
    view = inputs.views[0]
    leaves = leaves_on(torch.device("cpu"), inputs)
    feature_dim = inputs.features.shape[1]
    gradient = torch.rand(view.height, view.width, feature_dim)
    copying = Backend(device, shares_memory=False)

    def draw() -> None:
        output = _rasterize_on(copying, *leaves, *view.arguments, torch.zeros(feature_dim), RasterSettings())
        output.features.backward(gradient)

    print(f"  ours, CPU tensors, copied: forward + backward {median_milliseconds(draw):8.3f}")


def print_kernels(backend: CudaBackend, inputs: Inputs, wanted: Collection[str] | None = None) -> None:
    """Print each wanted kernel's time in a forward and backward pass, its registers and its memory; None: all."""
    profiled = CudaBackend(
        backend.device, backend.driver, backend.tensor_device, profile=True, compile_program=backend._compile
    )
    view = inputs.views[0]
    leaves = leaves_on(backend.tensor_device, inputs)
    background = torch.zeros(inputs.features.shape[1], device=backend.tensor_device)
    for _ in range(3):
        profiled.profiled = []
        output = _rasterize_on(profiled, *leaves, *view.arguments, background, RasterSettings())
        output.features.backward(torch.ones_like(output.features))
    totals: dict[str, list[int]] = {}
    for kernel, event in profiled.profiled or ():
        totals.setdefault(kernel, []).append(event.profile.end - event.profile.start)
    resources = profiled.resources()
    for kernel, times in sorted(totals.items(), key=lambda one: -sum(one[1])):
        if wanted is not None and kernel not in wanted:
            continue
        taken = f"{resources[kernel].registers:3} registers, {resources[kernel].private_bytes:5} bytes beside them"
        print(f"  {kernel:20} {len(times):3} launches {sum(times) / 1e6:8.3f} ms, a work-item: {taken}")
