"""Convolutions 3 x 3 of the CPU's tensors with a quarter of the multiplications, their ReLU, and the gradients.

Winograd's minimal filtering F(4 x 4, 3 x 3) (Lavin and Gray 2016): a tile of 4 x 4 pixels and what surrounds it become
its values at 36 points, for each of which the convolution is one product of matrices over the channels. With 64
channels, on one core of Emerald Rapids, milliseconds here / by torch (oneDNN) / by torch without AVX-512
(`tests/benchmarks/decoder_kernels.py`):

                                 112 x 200 pixels     448 x 800
    forward                    5.3 / 10.1 / 19.9       76 / 160
    gradient of the input      5.6 / 10.2 / 20.2       75 / 160
    gradient of the weights    6.3 / 12.2 / 40.7       79 / 239

On one core of Zen 3 (AVX2, 2.4 GHz), here / by torch, at 112 x 200: 9 / 18, 10 / 19 and 11 / 105. Products of matrices
take 5 ms of each, which is about all that its multipliers can; six rows at a time and chunks of 32 or 48 tiles gave
nothing.

An iteration of GS-Hider, of which most are these, takes 0.6 of the time (two trainings side by side, 178 ms for 304).
Rounding errors in float32, their root mean square over that of the result and over that of torch's errors (normally
distributed values, 16 to 96 channels, 50 x 28 and 112 x 200 pixels):

                               of the result       of torch's errors
    forward                   0.7e-6 to 1.4e-6         5 to 9
    gradient of the input     1.1e-6 to 2.1e-6         5 to 9
    gradient of the weights   1.1e-6 to 2.8e-6       1.0 to 1.8
    gradient of the bias      0.1e-6 to 0.3e-6      0.08 to 0.24

Of values and weights above zero, forward: 0.1e-6 to 0.2e-6, 0.8 to 2.3 times torch's.
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
"""As in winograd.cl, which is written for these: pixels of a tile's side, and its points."""

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
"""G: three taps at the points 0, 1, -1, 2, -2 and infinity."""
_KERNEL_AT_POINTS = torch.kron(_FILTER_AT_POINTS, _FILTER_AT_POINTS)
"""The same of nine taps, row by row, at the 36 pairs of points."""


def can_convolve(values: Float[Tensor, "B C H W"], weight: Float[Tensor, "D C height width"]) -> bool:
    """Whether `convolve` takes these: 3 x 3, channels in sixteens, float32 or float64, on a CPU of OpenCL's, too."""
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
    """`torch.nn.functional.conv2d(values, weight, bias, padding=1)`, its ReLU where `rectified`, up to rounding.

    Channels last, and `values` are taken fastest that are it, too. The same inputs give the same bits, for any number
    of threads. Raises ValueError for what `can_convolve` refuses, and where channels or the bias do not fit.
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
    """Of pictures [B,H,W,C] to pictures [B,H,W,D]: a Function's own result, not a view, may be changed in place."""

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


def _at_points(weight: Float[Tensor, "D C 3 3"]) -> Float[Tensor, "36 C D"]:
    """G g Gᵀ of every filter g."""
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
    """With `shown`, `pictures` are its gradient, which passes to what it was rectified from."""
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
    """Of the weight and of the bias."""
    backend = backend_in_place()
    inputs, outputs = pictures.shape[-1], gradients.shape[-1]
    groups = summing_items(_chunks(pictures))
    sums = backend.memory.empty(groups, (_POINTS * inputs + 1) * outputs, dtype=pictures.dtype)
    arguments = (gradients, _or_nothing(shown, pictures))
    _launch(backend, "weight_gradients", groups, (inputs, outputs), pictures, *arguments, result=sums)
    of_weight, of_bias = added(sums).split([_POINTS * inputs * outputs, outputs])
    taps = _of_taps(_of_taps(of_weight.view(6, 6, -1)).transpose(0, 1))
    return taps.view(3, 3, inputs, outputs).permute(3, 2, 1, 0), of_bias.clone()  # or it would keep all sums


def _of_taps(at_points: Float[Tensor, "6 K V"]) -> Float[Tensor, "3 K V"]:
    """Gᵀ along the first axis.

    Along both at once it would be one product with 36 terms, which MKL, on AMD's Zen 3, adds up in another order for
    two threads than for one; six it does not.
    """
    return (_FILTER_AT_POINTS.to(at_points.dtype).T @ at_points.reshape(6, -1)).view(3, *at_points.shape[1:])


def _or_nothing(shown: Tensor | None, like: Tensor) -> Tensor:
    """Kernels take an empty tensor for nothing."""
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
    """Run a kernel on pictures, with what else it reads and what it writes."""
    height, width = pictures.shape[1:3]
    steps = [_step(each) for each in channels]
    scratch = backend.memory.empty(groups, _POINTS, sum(steps), dtype=pictures.dtype)
    sizes = (_tiles(pictures), height, width, *channels, *steps)
    with backend.session() as session:
        program = product_program(backend, "convolution", pictures.dtype)
        session.launch(program, kernel, groups, *sizes, scratch, pictures, *arguments, result)
        session.finish(result)


def _step(channels: int) -> int:
    """Values from one point's matrix of a chunk to the next point's.

    A line of the cache more than the matrix has, as otherwise those that a tile has at all points would fall into the
    same few places of the cache.
    """
    return TILE_CHUNK * channels + LANES


def _tiles(pictures: Float[Tensor, "B H W C"]) -> int:
    batch, height, width, _ = pictures.shape
    return batch * -(-height // _SIDE) * -(-width // _SIDE)


def _chunks(pictures: Float[Tensor, "B H W C"]) -> int:
    return -(-_tiles(pictures) // TILE_CHUNK)
