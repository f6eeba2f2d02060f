"""A penalty that separates pictures sharing the features of their Gaussians, with gradients, in one pass on the CPU.

Each of N Gaussians i has M features f. Each of P pictures k has a direction u_k, along which a Gaussian's share of the
picture is read, and R readings r_kj, along which its content of the picture is read. With x = sigmoid(f) - 1/2, the
shares are s_k = u_k·x + 1/2, clamped to [0, 1]. With weights S and B, the penalty is

    S · mean_i Σ_{k<l} s_k s_l  +  B · Σ_k mean_ij max(0, |r_kj·x| - s_k / 2)

The gradients are computed together with the value. For two pictures and 60,000 Gaussians this takes 6.4 ms, against 16
with torch's own operations, forward and backward; for 150,000 Gaussians 13.6 and 41 ms (one core of Zen 3,
`tests/benchmarks/decoder_kernels.py`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.first_gradients import first_gradients_only
from opencl.products import added, filled, product_program, summing_items
from opencl.program import PIXEL_CHUNK
from opencl.routes import backend_in_place, works_in_place


def separation_penalty(
    features: Float[Tensor, "N M"],
    directions: Float[Tensor, "P M"],
    readings: Float[Tensor, "P R M"],
    common_weight: float,
    beyond_weight: float,
) -> Float[Tensor, ""]:
    """The scalar penalty defined above, where `common_weight` is S and `beyond_weight` is B.

    Gradients reach features and readings; s_k / 2 is treated as a constant. All tensors must be on the CPU, and all
    float32 or all float64. The same inputs give the same bits, for any number of threads. Raises ValueError if there is
    no Gaussian, channel, picture or reading, for wrong shapes or types, if `directions` requires a gradient, and if no
    OpenCL device works in the CPU's memory.
    """
    tensors = {"features": features, "directions": directions, "readings": readings}
    described = {name: (*tensor.shape, str(tensor.dtype), tensor.device.type) for name, tensor in tensors.items()}
    fits = features.ndim == directions.ndim == 2 and readings.ndim == 3 and directions.shape == readings.shape[::2]
    if not fits or features.shape[1] != directions.shape[1] or 0 in (*features.shape, *readings.shape):
        raise ValueError(
            f"separation_penalty: found {described}, expected [N,M], [P,M] and [P,R,M], none of them empty"
        )
    kinds = {(tensor.dtype, tensor.device.type) for tensor in tensors.values()}
    if kinds not in ({(torch.float32, "cpu")}, {(torch.float64, "cpu")}) or not works_in_place(features.device):
        raise ValueError(
            f"separation_penalty: found {described}, expected float32 or float64 of a CPU that OpenCL works on"
        )
    if directions.requires_grad and torch.is_grad_enabled():
        raise ValueError("separation_penalty: found directions that ask for a gradient (none is computed): detach them")
    receive = backend_in_place().memory.receive
    penalty: Tensor = _Separation.apply(receive(features), receive(readings), directions, common_weight, beyond_weight)
    return penalty


class _Separation(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, features: Tensor, readings: Tensor, directions: Tensor, common_weight: float, beyond_weight: float
    ) -> Tensor:
        (count, channels), (pictures, each, _) = features.shape, readings.shape
        sizes = _Filled(filled(channels), filled(pictures * each), filled(pictures))
        weights, turned = _layer(directions, readings.detach(), sizes)
        slopes = features.new_tensor([common_weight / count, beyond_weight / (count * each)])
        backend = backend_in_place()
        groups = summing_items(-(-count // PIXEL_CHUNK))
        scratch, sums, gradient = (
            backend.memory.empty(*shape, dtype=features.dtype)
            for shape in (
                (groups, sizes.scratch),
                (groups, sizes.gradients + 2),
                features.shape if any(ctx.needs_input_grad[:2]) else (0,),  # kernels receive an empty tensor as null
            )
        )
        program = product_program(backend, "separation", features.dtype)
        with backend.session() as session:
            numbers = (count, channels, pictures, *sizes, sizes.scratch)
            read = (slopes, features, weights, turned)
            session.launch(program, "separation", groups, *numbers, scratch, *read, gradient, sums)
            session.finish(gradient, sums)
        of_layer, totals = added(sums).split([sizes.gradients, 2])
        of_readings = of_layer.view(-1, sizes.readings)[:channels, : pictures * each].T.reshape(readings.shape)
        ctx.save_for_backward(gradient, of_readings)
        return (slopes * totals).sum()  # autocast would round a product of vectors to half precision

    @staticmethod
    @first_gradients_only
    def backward(ctx: Any, grad_penalty: Tensor) -> tuple[Tensor | None, ...]:
        of_features, of_readings = ctx.saved_tensors
        needs_features, needs_readings = ctx.needs_input_grad[:2]
        return (
            grad_penalty * of_features if needs_features else None,
            grad_penalty * of_readings if needs_readings else None,
            *(None, None, None),
        )


class _Filled(NamedTuple):
    """Numbers of channels, of readings of all pictures, and of pictures, each padded to a multiple of 16."""

    channels: int
    readings: int
    pictures: int

    @property
    def gradients(self) -> int:
        """Number of values in the gradient of all readings, and of a bias, which is not used."""
        return (self.channels + 1) * self.readings

    @property
    def scratch(self) -> int:
        """Number of values for a chunk: features, their gradients, readings, shares, and the share for each reading."""
        return PIXEL_CHUNK * (2 * self.channels + 2 * self.readings + self.pictures)


def _layer(
    directions: Float[Tensor, "P M"], readings: Float[Tensor, "P R M"], sizes: _Filled
) -> tuple[Float[Tensor, " weights"], Float[Tensor, "passing channels"]]:
    """The kernel's layer and, for its backward pass, the transposed weights of the parts that pass gradients.

    The layer is [channels + 1][outputs], the last row being the bias. Its outputs are all readings, the shares of all
    pictures, and for each reading the share of its own picture. The first two parts pass gradients.
    """
    each = readings.shape[1]
    layer = torch.cat(
        [
            _rows(readings.flatten(0, 1), 0.0, sizes.readings, sizes.channels),
            _rows(directions, 0.5, sizes.pictures, sizes.channels),
            _rows(directions.repeat_interleave(each, dim=0), 0.5, sizes.readings, sizes.channels),
        ]
    )
    return layer.T.flatten(), layer[: sizes.readings + sizes.pictures, :-1].contiguous()


def _rows(part: Float[Tensor, "K M"], bias: float, size: int, channels: int) -> Float[Tensor, "{size} {channels}+1"]:
    """A part of the layer, padded with zeros to `size` rows and `channels` columns, followed by the bias."""
    rows = part.new_zeros(size, channels + 1)
    rows[: len(part), : part.shape[1]] = part
    rows[: len(part), -1] = bias
    return rows
