"""Checks an NVIDIA GPU in one run: whether it computes what the CPU does, and how fast it is.

    pip install 'pyopencl[pocl]' jaxtyping filelock scipy pydantic      (besides torch with CUDA, and numpy)
    python -m tests.benchmarks.nvidia [--ptx FOLDER]

The rasterizer, structural similarity and spherical harmonics are compared with the CPU's, in torch's memory and by
copies; a training is run twice in each precision, once interrupted. Then drawing (beside gsplat, if it is installed),
decoding and similarities are timed. Only the trainings need scipy and pydantic: without these, only they fail. A check
that raises an exception fails, and the others continue. The exit status is 0 if all checks hold, 1 if one fails, and 2
if none can be run.

On an H100 (driver 580.159, torch 2.11, CUDA 13.0), all checks of 28 November 2026 held, in two and a half minutes, a
large part of which compilers take. Milliseconds, ours / gsplat 1.5.3's:

    Gaussians, pixels, features        forward     forward + backward    blend   blend_backward   other kernels
    200,000, 1216 x 800, M = 16      1.84 / 0.71       3.39 / 2.12        0.19        0.91              0.26
    1,000,000, 1600 x 1060, M = 16   2.28 / 1.66       7.09 / 7.45        0.82        4.12              0.82
    1,000,000, 1600 x 1060, M = 32   3.80 / 2.52       13.5 / 14.9        1.24        8.88              0.94

    1600 x 1060, two of each, forward and backward     M = 16     M = 32
    decoders of 64 channels, float32                    326        260
    the same, bfloat16                                  148         98
    the same, TF32                                       93         55
    similarities                                        4.6        4.7

    200,000 Gaussians in the CPU's memory, by copies: forward + backward 77

(No kernel's time includes torch's own sort by depth. For similarities, a work-item then had a strip, with 768 bytes
in memory. Now they work in tiles, without such bytes, and no GPU has run them. The same goes for the check of decoders
of single pixels, and for launching by `cuda.Arguments`.) As a work-item of blend_backward takes 180 registers (M = 32),
a multiprocessor has no room for a second group. `.minnctapersm 2` in its PTX gives 128, with nothing in memory.
`tests.benchmarks.nvidia_variants` measures what that gains, and what else is to be tried.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:  # otherwise imported only once `packages_are_there`
    from opencl.backend import Backend
    from opencl.bench.workloads import Inputs
    from opencl.cuda import CudaBackend
    from opencl.program import ProgramKey
    from tests.benchmarks.nvidia_checks import Draw

RASTERIZER_NEEDS = {"pyopencl": "'pyopencl[pocl]'", "jaxtyping": "jaxtyping", "filelock": "filelock"}
"""Imported modules, and how to ask pip for them."""
TRAINING_NEEDS = {"scipy": "scipy", "pydantic": "pydantic"}

LARGE = ("paper", "paper-32")
"""Workloads of the paper's size, timed in addition to B, which is small enough to be compared with CPUs."""

Check = Callable[[], bool | None]
"""Returns whether the check holds, or None if it only measures."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ptx", type=Path, metavar="FOLDER", help="where the programs' PTX is written; else nowhere")
    options = parser.parse_args(arguments)
    print(f"Python {sys.version.split()[0]}, torch {torch.__version__}, CUDA {torch.version.cuda}")
    if not packages_are_there():
        return 2
    backend = gpu_backend()
    if backend is None:
        return 2
    from opencl.bench.workloads import box_named

    if options.ptx is not None:
        write_ptx(backend, options.ptx)
    failed = failing(checks(backend, box_named("B").inputs))
    print(f"FAILS: {', '.join(failed)}" if failed else "all checks hold")
    return 1 if failed else 0


def packages_are_there() -> bool:
    """Whether the packages that the rasterizer needs are installed. Prints all that are missing."""
    missing = {
        name: wanted
        for name, wanted in (RASTERIZER_NEEDS | TRAINING_NEEDS).items()
        if importlib.util.find_spec(name) is None
    }
    if missing:
        print(f"not installed: pip install {' '.join(missing.values())}")
    return not missing.keys() & RASTERIZER_NEEDS.keys()


def gpu_backend() -> CudaBackend | None:
    """The backend of torch's CUDA device, set to give the same bits each time; or None, after printing why."""
    from opencl.__main__ import main as opencl_command
    from opencl.backend import default_backend
    from opencl.cuda import CudaBackend
    from opencl.routes import backend_for, working_device

    opencl_command(["devices"])
    if not torch.cuda.is_available():
        print("torch sees no CUDA device")
        return None
    print(torch.cuda.get_device_name(), f"driver's compute capability {torch.cuda.get_device_capability()}")
    device = working_device()  # before anything is computed there, as in trainings
    if device.type != "cuda":
        print(f"GS_HIDER_DEVICE names {os.environ['GS_HIDER_DEVICE']}, which is not torch's CUDA device: unset it")
        return None
    if not default_backend().device.is_cpu:
        print(f"nothing to compare with: CPU tensors would be drawn by {default_backend().device.describe()}")
        print("unset GS_HIDER_DEVICE; if it is not set: pip install 'pyopencl[pocl]'")
        return None
    backend = backend_for(device)
    if not isinstance(backend, CudaBackend):
        print(f"CUDA tensors would be drawn by {backend.device.describe()}, with copies: see what is missing above")
        return None
    return backend


def checks(backend: CudaBackend, inputs: Callable[[], Inputs]) -> Iterator[tuple[str, Check]]:
    """All checks of the GPU by name, then its measurements, on `inputs` and on larger workloads."""
    from opencl.backend import Backend
    from opencl.bench.workloads import box_named
    from tests.benchmarks import nvidia_checks, nvidia_timing

    device = backend.tensor_device
    draw, copying = nvidia_checks.drawn_on(device), Backend(backend.device, shares_memory=False)

    def training(precision: str, ours: bool = False) -> bool:
        from tests.benchmarks import nvidia_training

        return nvidia_training.check_training(
            device, precision, nvidia_training.OURS if ours else nvidia_training.WHOLE
        )

    yield from comparisons("in torch's memory", backend, draw)
    yield "runs", lambda: nvidia_checks.check_runs(draw)
    yield "torch's streams", lambda: nvidia_checks.check_streams(device)
    yield from comparisons("by copies", copying, nvidia_checks.drawn_by(copying))
    for precision in ("float32", "tf32", "bfloat16"):
        yield f"a training in {precision}", lambda precision=precision: training(precision)
    yield "a training with decoders of single pixels", lambda: training("float32", ours=True)
    yield "times", lambda: nvidia_timing.time_workload(device, inputs())
    yield "times by copies", lambda: nvidia_timing.time_copies(backend.device, inputs())
    yield "kernels", lambda: nvidia_timing.print_kernels(backend, inputs())
    for name in LARGE:
        large = box_named(name)
        yield f"times, {name}", lambda large=large: nvidia_timing.time_workload(device, large.inputs())
        yield f"kernels, {name}", lambda large=large: nvidia_timing.print_kernels(backend, large.inputs())
        yield f"decoders and similarities, {name}", lambda large=large: nvidia_timing.time_decoding(device, large)


def comparisons(where: str, backend: Backend, draw: Draw) -> Iterator[tuple[str, Check]]:
    """Checks that compare all that a backend computes with the CPU. `draw` must use this backend."""
    from tests.benchmarks import nvidia_checks

    yield f"{where}: small scenes", lambda: nvidia_checks.check_against_cpu(draw, nvidia_checks.CASES)
    yield f"{where}: similarities", lambda: nvidia_checks.check_similarities(backend)
    yield f"{where}: harmonics", lambda: nvidia_checks.check_harmonics(backend)
    yield f"{where}: many Gaussians", lambda: nvidia_checks.check_large(backend, draw, nvidia_checks.MANY)


def failing(named: Iterator[tuple[str, Check]]) -> list[str]:
    """Run checks and return the names of those that fail. If one raises an exception, its traceback is printed."""
    failed = []
    for name, check in named:
        print(f"\n{name}", flush=True)
        try:
            holds = check()
        except Exception:
            traceback.print_exc(file=sys.stdout)
            holds = False
        if holds is False:
            failed.append(name)
    return failed


def write_ptx(backend: CudaBackend, folder: Path) -> None:
    """From now on, write each program's PTX as NVIDIA's compiler returns it, before the driver loads it.

    A file's name states what it was compiled for, and ends in a digest of the source.
    """
    folder.mkdir(parents=True, exist_ok=True)
    compile_program = backend._compile

    def compile_and_write(program: ProgramKey) -> bytes:
        binary = compile_program(program)
        digest = hashlib.sha256(program.text().encode()).hexdigest()[:8]
        compiled_for = (program.part, str(program.dtype).removeprefix("torch."), f"M{program.feature_dim}")
        (folder / f"{'-'.join([*compiled_for, *program.options, digest])}.ptx").write_bytes(binary.rstrip(b"\0"))
        return binary

    backend._compile = compile_and_write


if __name__ == "__main__":
    sys.exit(main())
