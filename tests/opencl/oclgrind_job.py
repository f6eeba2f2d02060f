"""The jobs that run under Oclgrind.

    python -m tests.opencl.oclgrind_job draw SCHEDULE FEATURE_DIM DTYPE
    python -m tests.opencl.oclgrind_job crowd SCHEDULE
    python -m tests.opencl.oclgrind_job compare|color SCHEDULE
    python -m tests.opencl.oclgrind_job convolve|decode_pixels|separate|broken

Oclgrind interprets kernels, so pictures are small. The broken kernels prove that its reports reach the test.
"""

from __future__ import annotations

import sys

import numpy as np
import pyopencl
from torch import Tensor

from opencl import convolution, pixel_decoder, separation
from opencl.device import choose_device
from opencl.harmonics import _Colors
from opencl.program import Schedule
from opencl.ssim import _MeanSsim
from stages.imaging.ssim import ssim_map
from tests.opencl import test_convolution, test_harmonics, test_pixel_decoder, test_separation, test_ssim
from tests.opencl.differentiated import with_gradients
from tests.opencl.runtimes import backend_of, draw_with_gradients, dtype_of
from tests.opencl.scenes import Scene, gradients, make_scene

BROKEN = {
    "write_out_of_bounds": "values[get_global_id(0) + 1] = 1;",
    "read_out_of_bounds": "values[get_global_id(0)] = values[get_global_id(0) + 1];",
    "missing_barrier": """
        __local int shared[4];
        shared[get_local_id(0)] = get_local_id(0);
        values[get_global_id(0)] = shared[3 - get_local_id(0)];
    """,
    "work_groups_write_the_same": "if (get_local_id(0) == 0) values[0] = 1;",
    "uninitialised_private": "int never[2]; if (never[values[0]] > 3) values[get_global_id(0)] = 1;",
    "uninitialised_local": "__local int never[4]; if (never[3] > 3) values[get_global_id(0)] = 1;",
    "correct": "values[get_global_id(0)] = get_local_id(0);",
}


def draw(schedule: Schedule, feature_dim: int, dtype: str) -> None:
    """Draw 20 Gaussians on one and a half tiles, forward and backward; print the error against the reference."""
    print_error(schedule, make_scene(20, feature_dim, 24, 16, dtype=dtype_of(dtype)))


def crowd(schedule: Schedule) -> None:
    """The same for a tile with several batches of Gaussians; with absolute gradients and pixel counts."""
    scene = make_scene(300, 3, 16, 16, opacity=(0.01, 0.05), dtype=dtype_of("float32"))
    print_error(schedule, scene, absolute_gradients=True, count_pixels=True)


def print_error(schedule: Schedule, scene: Scene, **wishes: bool) -> None:
    output, found = draw_with_gradients(backend_of(schedule), scene, **wishes)
    leaves = tuple(tensor.requires_grad_() for tensor in (*scene.gaussians, scene.background))
    expected = scene.draw_reference()
    errors = [(output.features - expected.features).abs().max().item()]
    for one, other in zip(found, gradients(expected, leaves), strict=True):
        errors.append(((one - other).norm() / other.norm()).item())
    print(max(errors))


def compare(schedule: Schedule) -> None:
    """Compare two small pictures by their structural similarity, both ways; print the error against torch."""
    picture, truth = test_ssim.pair(2, 13, 25)
    value, gradient = test_ssim.value_and_gradient(_MeanSsim.apply(backend_of(schedule), picture, truth), picture)
    expected = test_ssim.value_and_gradient(ssim_map(picture, truth).mean(), picture)
    print(largest_error([value, gradient], list(expected)))


def color(schedule: Schedule) -> None:
    """The same for colours of spherical harmonics, with one Gaussian in the last chunk."""
    base, rest, means, centre = test_harmonics.inputs(33)
    leaves = tuple(tensor.requires_grad_() for tensor in (base, rest, means))
    found = _Colors.apply(backend_of(schedule), 3, *leaves, centre)
    expected = test_harmonics.oracle(*leaves, centre, 3)
    of_both = (test_harmonics.gradients(colors, leaves) for colors in (found, expected))
    print(largest_error(*([colors, *each] for colors, each in zip((found, expected), of_both, strict=True))))


def convolve() -> None:
    """Convolve two small pictures whose last tiles extend beyond them, both ways; print the error against torch."""
    leaves = test_convolution.inputs(2, 16, 32, 5, 11)
    backend = backend_of("cpu")
    convolution.backend_in_place = lambda: backend
    convolution.can_convolve = lambda *_: True
    found = with_gradients(convolution.convolve(*leaves, True), leaves)
    expected = test_convolution.expected(*leaves, True)
    print(largest_error(found, with_gradients(expected, leaves)))


def decode_pixels() -> None:
    """The same for a pixel decoder, with one pixel in the last chunk."""
    leaves = test_pixel_decoder.decoder(33, 5, 32, 3)
    listed = test_pixel_decoder.listed(*leaves)
    backend = backend_of("cpu")
    pixel_decoder.backend_in_place = lambda: backend
    pixel_decoder.works_in_place = lambda _: True
    found = with_gradients(pixel_decoder.decode_pixels(*leaves), listed)
    expected = test_pixel_decoder.expected(*leaves)
    print(largest_error(found, with_gradients(expected, listed)))


def separate() -> None:
    """The same for the separation penalty, with one Gaussian in the last chunk."""
    features, directions, readings = test_separation.inputs(33, 5, 2, 3)
    backend = backend_of("cpu")
    separation.backend_in_place = lambda: backend
    separation.works_in_place = lambda _: True
    found = with_gradients(test_separation.penalty(features, directions, readings), [features, readings])
    expected = test_separation.expected(features, directions, readings)
    print(largest_error(found, with_gradients(expected, [features, readings])))


def largest_error(found: list[Tensor], expected: list[Tensor]) -> float:
    return max(((one - other).norm() / other.norm()).item() for one, other in zip(found, expected, strict=True))


def run_broken() -> None:
    """Run each kernel of BROKEN in two groups of four work-items on eight integers, and print its name."""
    context = pyopencl.Context([choose_device().handle])
    queue = pyopencl.CommandQueue(context)
    for name, body in BROKEN.items():
        source = f"__kernel void {name}(__global int *values) {{ {body} }}"
        kernel = pyopencl.Kernel(pyopencl.Program(context, source).build(cache_dir=False), name)
        flags = pyopencl.mem_flags.READ_WRITE | pyopencl.mem_flags.COPY_HOST_PTR
        kernel(queue, (8,), (4,), pyopencl.Buffer(context, flags, hostbuf=np.zeros(8, np.int32)))
        queue.finish()
        print(name)


if __name__ == "__main__":
    chosen: Schedule = "gpu" if "gpu" in sys.argv else "cpu"
    if sys.argv[1] == "draw":
        draw(chosen, int(sys.argv[3]), sys.argv[4])
    elif sys.argv[1] == "crowd":
        crowd(chosen)
    elif sys.argv[1] == "compare":
        compare(chosen)
    elif sys.argv[1] == "color":
        color(chosen)
    elif sys.argv[1] == "convolve":
        convolve()
    elif sys.argv[1] == "decode_pixels":
        decode_pixels()
    elif sys.argv[1] == "separate":
        separate()
    else:
        run_broken()
