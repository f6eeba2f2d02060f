"""3 x 3 convolutions of CPU tensors with a quarter of the multiplications, an optional ReLU, and gradients.

Uses Winograd's minimal filtering F(4 x 4, 3 x 3) (Lavin and Gray 2016): a tile of 4 x 4 pixels and its surroundings
are transformed to values at 36 points, and at each point the convolution is a single matrix product over the channels.
Times in milliseconds with 64 channels, on one core of Emerald Rapids: ours / torch (oneDNN) / torch without AVX-512
(`tests/benchmarks/decoder_kernels.py`):

                                 112 x 200 pixels     448 x 800
    forward                    5.3 / 10.1 / 19.9       76 / 160
    gradient of the input      5.6 / 10.2 / 20.2       75 / 160
    gradient of the weights    6.3 / 12.2 / 40.7       79 / 239

On one core of Zen 3 (AVX2, 2.4 GHz) at 112 x 200, ours / torch: 9 / 18, 10 / 19 and 11 / 105. Matrix products take 5 ms
of each of ours, which is close to the peak of its multipliers. Multiplying six rows at a time and chunks of 32 or 48
tiles were no faster.

Most of the time of a GS-Hider training is spent in these convolutions. One of its iterations takes 178 ms with ours,
304 ms with torch's (0.6 of the time, two trainings side by side). Rounding errors in float32, as root mean square
relative to that of the result and to that of torch's errors (normally distributed values, 16 to 96 channels, 50 x 28
and 112 x 200 pixels):

                               of the result       of torch's errors
    forward                   0.7e-6 to 1.4e-6         5 to 9
    gradient of the input     1.1e-6 to 2.1e-6         5 to 9
    gradient of the weights   1.1e-6 to 2.8e-6       1.0 to 1.8
    gradient of the bias      0.1e-6 to 0.3e-6      0.08 to 0.24

With positive values and weights, forward: 0.1e-6 to 0.2e-6 of the result, 0.8 to 2.3 times torch's errors.
"""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.backend import Backend
from opencl.first_gradients import first_gradients_only
from opencl.products import LANES, added, product_program, summing_items, work_items
from opencl.program import TILE_CHUNK
from opencl.routes import backend_in_place, works_in_place

_SIDE, _POINTS = 4, 36
"""Side of a tile in pixels, and its number of points. winograd.cl is written for these values only."""

_FILTER_AT_POINTS = torch.tensor(
    [
        [1 / 4, 0, 0],
        [-1 / 6, -1 / 6, -1 / 6],
        [-1 / 6, 1 / 6, -1 / 6],
        [1 / 24, 1 / 12, 1 / 6],
        [1 / 24, -1 / 12, 1 / 6],
        [0, 0, 1],
    ],
    dtype=torch.float64,
)
"""G of Winograd's filtering: evaluates three taps at the points 0, 1, -1, 2, -2 and infinity."""
_KERNEL_AT_POINTS = torch.kron(_FILTER_AT_POINTS, _FILTER_AT_POINTS)
"""G ⊗ G [36,9]: evaluates the nine taps of a filter, row by row, at all 36 pairs of points."""


def can_convolve(values: Float[Tensor, "*batch C H W"], weight: Float[Tensor, "D C height width"]) -> bool:
    """Whether `convolve` supports these tensors.

    The filters must be 3 x 3, the numbers of channels multiples of 16, `values` not empty, and both tensors float32, or
    both float64, on a CPU on which OpenCL works.
    """
    return (
        weight.shape[2:] == (3, 3)
        and weight.shape[0] % LANES == weight.shape[1] % LANES == 0
        and values.ndim == 4
        and values.numel() > 0
        and values.dtype == weight.dtype in (torch.float32, torch.float64)
        and values.device.type == weight.device.type == "cpu"
        and works_in_place(values.device)
    )


def convolve(
    values: Float[Tensor, "B C H W"],
    weight: Float[Tensor, "D C 3 3"],
    bias: Float[Tensor, " D"],
    rectified: bool = False,
) -> Float[Tensor, "B D H W"]:
    """`torch.nn.functional.conv2d(values, weight, bias, padding=1)` up to rounding, followed by a ReLU if `rectified`.

    The result is channels-last; `values` are copied unless they are channels-last, too. The same inputs give the same
    bits, for any number of threads. Raises ValueError for tensors that `can_convolve` refuses, and if the channels or
    the bias do not match the weight.
    """
    bias_fits = bias.shape == weight.shape[:1] and bias.dtype == weight.dtype and bias.device == weight.device
    if not can_convolve(values, weight) or values.shape[1] != weight.shape[1] or not bias_fits:
        described = [f"{tuple(tensor.shape)} {tensor.dtype} on {tensor.device}" for tensor in (values, weight, bias)]
        raise ValueError(
            f"convolve: found {described}, expected values (B, C, H, W), a weight (D, C, 3, 3) and a bias (D), C and D "
            f"multiples of {LANES}, alike float32 or float64, on a CPU that OpenCL works on"
        )
    receive = backend_in_place().memory.receive
    convolved: Tensor = _Convolve.apply(receive(values.permute(0, 2, 3, 1)), weight, receive(bias), rectified)
    return convolved.permute(0, 3, 1, 2)


class _Convolve(torch.autograd.Function):
    """Pictures [B,H,W,C] → [B,H,W,D]. The result is not a view, so that torch allows changes of it in place."""

    @staticmethod
    def forward(ctx: Any, pictures: Tensor, weight: Tensor, bias: Tensor, rectified: bool) -> Tensor:
        convolved = _convolved(pictures, None, _at_points(weight), bias, rectified)
        ctx.save_for_backward(pictures, weight, convolved if rectified else None)
        return convolved

    @staticmethod
    @first_gradients_only
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        pictures, weight, shown = ctx.saved_tensors
        gradients = backend_in_place().memory.receive(gradient)
        of_pictures, of_weight, of_bias = None, None, None
        if ctx.needs_input_grad[0]:
            turned = weight.flip(2, 3).transpose(0, 1)
            of_pictures = _convolved(gradients, shown, _at_points(turned), gradient.new_zeros(len(turned)))
        if any(ctx.needs_input_grad[1:3]):
            of_weight, of_bias = _gradients_of_weights(pictures, gradients, shown)
        return of_pictures, of_weight, of_bias, None


@torch.autocast("cpu", enabled=False)
def _at_points(weight: Float[Tensor, "D C 3 3"]) -> Float[Tensor, "36 C D"]:
    """G g Gᵀ for every filter g."""
    outputs, inputs = weight.shape[:2]
    taps = weight.permute(2, 3, 1, 0).reshape(9, -1)
    return (_KERNEL_AT_POINTS.to(weight.dtype) @ taps).view(_POINTS, inputs, outputs)


def _convolved(
    pictures: Float[Tensor, "B H W C"],
    shown: Float[Tensor, "B H W C"] | None,
    weight_at_points: Float[Tensor, "36 C D"],
    bias: Float[Tensor, " D"],
    rectified: bool = False,
) -> Float[Tensor, "B H W D"]:
    """Convolve `pictures`. With `shown`, a ReLU's output, they are its gradient and first pass through the ReLU."""
    backend = backend_in_place()
    _, inputs, outputs = weight_at_points.shape
    convolved = backend.memory.empty(*pictures.shape[:3], outputs, dtype=pictures.dtype)
    arguments = (_or_nothing(shown, pictures), weight_at_points, bias, int(rectified))
    groups = work_items(backend, _chunks(pictures))
    _launch(backend, "convolve", groups, (inputs, outputs), pictures, *arguments, result=convolved)
    return convolved


def _gradients_of_weights(
    pictures: Float[Tensor, "B H W C"], gradients: Float[Tensor, "B H W D"], shown: Float[Tensor, "B H W D"] | None
) -> tuple[Float[Tensor, "D C 3 3"], Float[Tensor, " D"]]:
    """Gradients of the weight and the bias, given those of the output and, after a ReLU, the output `shown`."""
    backend = backend_in_place()
    inputs, outputs = pictures.shape[-1], gradients.shape[-1]
    groups = summing_items(_chunks(pictures))
    sums = backend.memory.empty(groups, (_POINTS * inputs + 1) * outputs, dtype=pictures.dtype)
    arguments = (gradients, _or_nothing(shown, pictures))
    _launch(backend, "weight_gradients", groups, (inputs, outputs), pictures, *arguments, result=sums)
    of_weight, of_bias = added(sums).split([_POINTS * inputs * outputs, outputs])
    taps = _of_taps(_of_taps(of_weight.view(6, 6, -1)).transpose(0, 1))
    return taps.view(3, 3, inputs, outputs).permute(3, 2, 1, 0), of_bias.clone()  # a view would keep all sums


@torch.autocast("cpu", enabled=False)
def _of_taps(at_points: Float[Tensor, "6 K V"]) -> Float[Tensor, "3 K V"]:
    """Apply Gᵀ along the first axis.

    A single product along both axes would sum 36 terms, which MKL on AMD's Zen 3 adds in a different order with two
    threads than with one. It does not do so with six terms.
    """
    return (_FILTER_AT_POINTS.to(at_points.dtype).T @ at_points.reshape(6, -1)).view(3, *at_points.shape[1:])


def _or_nothing(shown: Tensor | None, like: Tensor) -> Tensor:
    """`shown`, or an empty tensor, which kernels receive as a null pointer."""
    return like.new_empty(0) if shown is None else shown


def _launch(
    backend: Backend,
    kernel: str,
    groups: int,
    channels: tuple[int, int],
    pictures: Float[Tensor, "B H W C"],
    *arguments: Tensor | int,
    result: Tensor,
) -> None:
    """Run a kernel on `pictures` and `arguments`, and wait for its `result`."""
    height, width = pictures.shape[1:3]
    steps = [_step(each) for each in channels]
    scratch = backend.memory.empty(groups, _POINTS, sum(steps), dtype=pictures.dtype)
    sizes = (_tiles(pictures), height, width, *channels, *steps)
    with backend.session() as session:
        program = product_program(backend, "convolution", pictures.dtype)
        session.launch(program, kernel, groups, *sizes, scratch, pictures, *arguments, result)
        session.finish(result)


def _step(channels: int) -> int:
    """Stride, in values, between the matrices of consecutive points of a chunk.

    It exceeds the size of a matrix by one cache line (in float32). Otherwise the values of a tile at all points would
    map to the same few cache sets.
    """
    return TILE_CHUNK * channels + LANES


def _tiles(pictures: Float[Tensor, "B H W C"]) -> int:
    batch, height, width, _ = pictures.shape
    return batch * -(-height // _SIDE) * -(-width // _SIDE)


def _chunks(pictures: Float[Tensor, "B H W C"]) -> int:
    return -(-_tiles(pictures) // TILE_CHUNK)
