"""Per-pixel decoders on the CPU, with gradients: all layers run on a few pixels while these are in the cache.

1 x 1 convolutions are small matrix products, and torch spends most of its time moving the output of each layer to
memory and back. A decoder with 16, 32, 32, 32, 32 and 3 channels, forward and backward, takes 8 ms instead of torch's
12 at 112 x 200 pixels, and 117 ms instead of 327 at 448 x 800 (one core of Emerald Rapids,
`tests/benchmarks/decoder_kernels.py`). A training iteration of our method takes 74 ms instead of 89 at the smaller size
(two trainings side by side).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.backend import Backend
from opencl.first_gradients import first_gradients_only
from opencl.products import added, filled, product_program, summing_items, work_items
from opencl.program import PIXEL_CHUNK
from opencl.routes import backend_in_place, works_in_place


def decode_pixels(
    picture: Float[Tensor, "*pixels C"],
    weights: Sequence[Float[Tensor, "outputs inputs"]],
    biases: Sequence[Float[Tensor, " outputs"]],
) -> Float[Tensor, "*pixels D"]:
    """Apply layers W·x + b to the channels of each pixel, with a ReLU after each but the last.

    All tensors must be on the CPU, and all float32 or all float64. Without pixels, the result is empty. Gradients reach
    the picture, weights and biases. The same inputs give the same bits, for any number of threads. Raises ValueError if
    there is no layer or a layer has no channel, for wrong shapes or types, and if no OpenCL device works in the CPU's
    memory.
    """
    widths = [picture.shape[-1], *[len(weight) for weight in weights]]
    described = [tuple(tensor.shape) for tensor in (picture, *weights, *biases)]
    fits = len(weights) == len(biases) > 0 < min(widths) and all(
        weight.shape == (outputs, inputs) and bias.shape == (outputs,)
        for weight, bias, inputs, outputs in zip(weights, biases, widths[:-1], widths[1:], strict=True)
    )
    if not fits:
        raise ValueError(f"decode_pixels: found shapes {described}, expected channels, then weights and biases on them")
    kinds = {(tensor.dtype, tensor.device.type) for tensor in (picture, *weights, *biases)}
    if kinds not in ({(torch.float32, "cpu")}, {(torch.float64, "cpu")}) or not works_in_place(picture.device):
        raise ValueError(f"decode_pixels: found {kinds}, expected float32 or float64 of a CPU that OpenCL works on")
    pixels = backend_in_place().memory.receive(picture.reshape(-1, widths[0]))
    decoded: Tensor = _DecodePixels.apply(pixels, len(weights), *weights, *biases)
    return decoded.view(*picture.shape[:-1], widths[-1])


class _DecodePixels(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, picture: Tensor, layers: int, *parameters: Tensor) -> Tensor:
        ctx.layers = layers
        ctx.save_for_backward(picture, *parameters)
        work = _Work(picture, parameters[:layers])
        decoded = work.memory.empty(len(picture), len(parameters[layers - 1]), dtype=picture.dtype)
        packed = work.packed(parameters[:layers], parameters[layers:], turned=False)
        groups = work_items(work.backend, work.chunks)
        work.launch("decode_pixels", groups, picture, packed, results=(decoded,))
        return decoded

    @staticmethod
    @first_gradients_only
    def backward(ctx: Any, grad_decoded: Tensor) -> tuple[Tensor | None, ...]:
        picture, *parameters = ctx.saved_tensors
        weights, biases = parameters[: ctx.layers], parameters[ctx.layers :]
        work = _Work(picture, weights)
        needs_picture, needs_weights = ctx.needs_input_grad[0], any(ctx.needs_input_grad[2:])
        groups = summing_items(work.chunks) if needs_weights else work_items(work.backend, work.chunks)
        # Kernels receive an empty tensor as a null pointer.
        grad_picture = work.memory.empty(len(picture) if needs_picture else 0, work.channels, dtype=picture.dtype)
        sums = work.memory.empty(groups if needs_weights else 0, work.weight_count, dtype=picture.dtype)
        packed = (work.packed(weights, biases, turned=turned) for turned in (False, True))
        work.launch(
            *("decode_pixels_backward", groups, picture, *packed, work.memory.receive(grad_decoded)),
            results=(grad_picture, sums),
        )
        of_parameters = work.unpacked(added(sums), weights) if needs_weights else [None] * len(parameters)
        return grad_picture if needs_picture else None, None, *of_parameters


class _Work:
    """A decoder and its picture in the kernels' layout: channels padded to multiples of 16."""

    def __init__(self, picture: Float[Tensor, "N C"], weights: Sequence[Float[Tensor, "outputs inputs"]]) -> None:
        self.backend: Backend = backend_in_place()
        self.memory = self.backend.memory
        self.pixels, self.channels = picture.shape
        self.outputs, self.dtype = len(weights[-1]), picture.dtype
        self.widths = [filled(self.channels), *(filled(len(weight)) for weight in weights)]
        self.chunks = -(-self.pixels // PIXEL_CHUNK)
        self.weight_count = sum((inputs + 1) * outputs for inputs, outputs in self._layers())

    def _layers(self) -> Iterator[tuple[int, int]]:
        return pairwise(self.widths)

    def packed(self, weights: Sequence[Tensor], biases: Sequence[Tensor], turned: bool) -> Float[Tensor, " weights"]:
        """All layers in order: the weight as [inputs][outputs], or [outputs][inputs] if `turned`, then the bias."""
        parts = []
        for weight, bias, (inputs, outputs) in zip(weights, biases, self._layers(), strict=True):
            whole = weight.new_zeros(outputs, inputs)
            whole[: weight.shape[0], : weight.shape[1]] = weight.detach()
            parts += [(whole if turned else whole.T).flatten(), bias.new_zeros(outputs)]
            parts[-1][: len(bias)] = bias.detach()
        return torch.cat(parts)

    def unpacked(self, sums: Float[Tensor, " weights"], weights: Sequence[Tensor]) -> list[Tensor]:
        """The gradients of all weights, then those of all biases, without padding."""
        sizes = [size for inputs, outputs in self._layers() for size in (inputs * outputs, outputs)]
        parts = sums.split(sizes)
        of_weights = [
            part.view(inputs, outputs).T[: weight.shape[0], : weight.shape[1]]
            for part, weight, (inputs, outputs) in zip(parts[::2], weights, self._layers(), strict=True)
        ]
        return [*of_weights, *(part[: len(weight)] for part, weight in zip(parts[1::2], weights, strict=True))]

    def launch(self, kernel: str, groups: int, *inputs: Tensor, results: tuple[Tensor, ...]) -> None:
        """Run a kernel on `inputs` and wait for its `results`. Without pixels, nothing runs."""
        scratch_size = PIXEL_CHUNK * (sum(self.widths) + 2 * max(self.widths))
        scratch = self.memory.empty(groups, scratch_size, dtype=self.dtype)
        sizes = (self.pixels, self.channels, self.outputs, len(self.widths) - 1, scratch_size)
        widths = torch.tensor(self.widths, dtype=torch.int32)
        with self.backend.session() as session:
            program = product_program(self.backend, "pixel_decoder", self.dtype)
            session.launch(program, kernel, groups, *sizes, scratch, widths, *inputs, *results)
            session.finish(*results)
