"""Measures what to try next on an NVIDIA GPU, each variant beside the current one. Not yet run on a GPU.

    python -m tests.benchmarks.nvidia_variants [decoders] [registers] [python] [iterations]

- decoders: layouts of the feature map, precisions, and how cuDNN chooses its algorithms. In the first run of
  `tests.benchmarks.nvidia`, the paper's two decoders took 326 ms in float32 at 1600 x 1060, while an H100 could do
  their 2.5e12 operations in 40: is cuDNN's choice the reason?
- registers: the blending kernels if the driver's assembler must leave room for a number of groups on a multiprocessor.
- python: which Python functions make launching slow.
- iterations: where training iterations at 800 x 532 spend their time, in float32 and tf32.

The requirements, and how OpenCL finds the GPU, are as in `tests.benchmarks.nvidia`.
"""

from __future__ import annotations

import cProfile
import pstats
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from unittest import mock

import torch
from torch import Tensor

from tests.benchmarks.nvidia import gpu_backend

WIDTH, HEIGHT = 1600, 1060
DECODERS = {"GS-Hider": (64, 3), "homogeneous": (32, 1)}
"""(Channels between the layers, side of their kernels)."""
ROOM = (0, 2, 3, 4, 5)
"""Groups on a multiprocessor; 0 leaves their number to the assembler."""
CALLS = 100


def decoders() -> None:
    """Print the milliseconds of one decoder, forward, and forward with backward."""
    from stages.hiding.decoders import Decoder
    from tests.benchmarks.nvidia_timing import median_milliseconds

    feature_map = torch.rand(HEIGHT, WIDTH, 16, device="cuda", requires_grad=True)
    for name, (width, side) in DECODERS.items():
        decoder = Decoder(16, 3, width=width, kernel_size=side).cuda()
        for precision in ("float32", "tf32", "bfloat16"):
            for channels_last in (True, False):
                layout = torch.channels_last if channels_last else torch.contiguous_format
                decoder.to(memory_format=layout)  # type: ignore[call-overload]  # torch's stub omits it
                for deterministic, chosen_by_time in ((True, False), (True, True), (False, True)):
                    draw = _decoding(decoder, feature_map, layout, precision)
                    with _cudnn(deterministic, chosen_by_time, precision == "tf32"):
                        with torch.no_grad():
                            forward = median_milliseconds(draw)
                        both = median_milliseconds(lambda draw=draw: draw().sum().backward())
                    how = f"{'deterministic' if deterministic else 'any'}, {'by time' if chosen_by_time else 'by rule'}"
                    print(f"  {name}, {precision}, {layout}, {how}: {forward:.2f}, {both:.2f}", flush=True)


def _decoding(
    decoder: torch.nn.Sequential, feature_map: Tensor, layout: torch.memory_format, precision: str
) -> Callable[[], Tensor]:
    first, *between, last = (module for module in decoder if isinstance(module, torch.nn.Conv2d))
    convolve = torch.nn.Conv2d.forward

    def draw() -> Tensor:
        values = feature_map.permute(2, 0, 1).unsqueeze(0).contiguous(memory_format=layout)
        values = torch.relu(convolve(first, values))
        with torch.autocast("cuda", dtype=torch.bfloat16, enabled=precision == "bfloat16"):
            for convolution in between:
                values = torch.relu(convolve(convolution, values))
        return convolve(last, values.float())

    return draw


@contextmanager
def _cudnn(deterministic: bool, chosen_by_time: bool, rounded: bool) -> Iterator[None]:
    library, before = torch.backends.cudnn, torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(deterministic, warn_only=True)
    try:
        with library.flags(enabled=True, benchmark=chosen_by_time, deterministic=deterministic, allow_tf32=rounded):
            yield
    finally:
        torch.use_deterministic_algorithms(before, warn_only=True)


def registers() -> None:
    """Print the blending kernels' times, and the registers and memory of a work-item."""
    import opencl.cuda
    from opencl.bench.workloads import Box, box_named
    from tests.benchmarks.nvidia_timing import print_kernels

    backend = gpu_backend()
    if backend is None:
        return
    rewrite = opencl.cuda.rewrite_for_cuda
    for box in (box_named("B"), box_named("paper"), box_named("paper-32"), Box("colours", 1_000_000, WIDTH, HEIGHT, 3)):
        for groups in ROOM:

            def with_room(binary: bytes, exact: bool = False, groups: int = groups) -> opencl.cuda.CudaProgram:
                program = rewrite(binary, exact)
                if "blend" not in program.kernels or not groups:
                    return program
                size = ".reqntid 256, 1, 1"
                if size not in program.text:
                    raise SystemExit(f"this driver's PTX does not say {size!r}: nothing would change")
                return opencl.cuda.CudaProgram(
                    program.text.replace(size, f"{size}\n.minnctapersm {groups}"), program.kernels
                )

            print(f"{box.name}, room for {groups or 'any'} groups", flush=True)
            with mock.patch.object(opencl.cuda, "rewrite_for_cuda", with_room):
                print_kernels(backend, box.inputs(), ("blend", "blend_backward"))


def python() -> None:
    """Profile Python while it draws, forward and backward."""
    from opencl.bench.workloads import box_named
    from opencl.rasterizer import rasterize
    from tests.benchmarks.nvidia_timing import leaves_on

    inputs = box_named("B").inputs()
    view, leaves = inputs.views[0], leaves_on(torch.device("cuda", 0), inputs)
    profile = cProfile.Profile()
    for call in range(2 * CALLS):
        if call == CALLS:
            torch.cuda.synchronize()
            profile.enable()
        rasterize(*leaves, *view.arguments).features.sum().backward()
    profile.disable()
    pstats.Stats(profile, stream=sys.stdout).sort_stats("tottime").print_stats(30)


def iterations() -> None:
    """Time the parts of an iteration, waiting for each, and then whole iterations without waiting."""
    from stages.timing.stopwatch import Stopwatch, watching
    from tests.benchmarks.nvidia_training import Size, prepared
    from tests.benchmarks.training_iteration import clock_of

    device = torch.device("cuda", 0)
    size = Size(points=200_000, width=800, height=532, feature_dim=16, layers=5, decoder_width=32, kernel_size=1)
    for precision in ("float32", "tf32"):
        training = prepared(device, precision, size)
        for iteration in range(1, 4):
            training.step(iteration)
        with watching(Stopwatch(clock_of(device))) as stopwatch:
            for iteration in range(4, 24):
                training.step(iteration)
        print(precision, stopwatch.table(20), flush=True)
        torch.cuda.synchronize()
        start = time.perf_counter()
        for iteration in range(24, 44):
            training.step(iteration)
        torch.cuda.synchronize()
        print(f"  {(time.perf_counter() - start) / 20 * 1e3:.1f} ms an iteration, not waited for", flush=True)


def main(names: list[str]) -> int:
    if gpu_backend() is None:
        return 2
    for name in names or ("decoders", "registers", "python", "iterations"):
        print(f"\n{name}", flush=True)
        {"decoders": decoders, "registers": registers, "python": python, "iterations": iterations}[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
