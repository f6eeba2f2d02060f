"""What keeps pictures apart that share their Gaussians' features, and its gradients, in one pass on the CPU.

Each of N Gaussians has M features f, P pictures a direction u_k each, along which a Gaussian's share of the picture is
read, and R readings r_kj, along which what it holds of the picture is. With x = sigmoid(f) - 1/2 the shares are
s_k = u_k·x + 1/2, clamped to [0, 1], and with weights S and B the penalty is

    S · mean_i Σ_{k<l} s_k s_l  +  B · Σ_k mean_ij max(0, |r_kj·x| - s_k / 2)

The gradients are computed beside the value. Of two pictures and 60,000 Gaussians that takes 6.4 ms, by torch's own
operations, forward and backward, 16; of 150,000 13.6 and 41 (one core of Zen 3, `tests/benchmarks/decoder_kernels.py`).
"""

from __future__ import annotations

from typing import Any

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
    """The penalty above, a scalar. Its gradient reaches features and readings; s_k / 2 counts as a constant.

    All on the CPU, alike float32 or float64. The same inputs give the same bits, for any number of threads. Raises
    ValueError where there is no Gaussian, channel, picture or reading, where shapes or types do not fit, where
    `directions` ask for a gradient, and where no OpenCL device works in the CPU's memory.
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
        backend, like = backend_in_place(), features.new_empty(0)
        (count, channels), (pictures, each, _) = features.shape, readings.shape
        sizes = [filled(size) for size in (channels, pictures * each, pictures)]
        weights, turned = _layer(directions, readings, sizes)
        groups = summing_items(-(-count // PIXEL_CHUNK))
        scratch_size = PIXEL_CHUNK * (2 * sizes[0] + 2 * sizes[1] + sizes[2])
        empty = backend.memory.empty
        scratch = empty(groups, scratch_size, dtype=features.dtype)
        gradient = empty(*features.shape, dtype=features.dtype) if any(ctx.needs_input_grad[:2]) else like
        sums = empty(groups, (sizes[0] + 1) * sizes[1] + 2, dtype=features.dtype)
        slopes = features.new_tensor([common_weight / count, beyond_weight / (count * each)])
        program = product_program(backend, "separation", features.dtype)
        with backend.session() as session:
            numbers = (count, channels, pictures, *sizes, scratch_size)
            read = (slopes, features, weights, turned)
            session.launch(program, "separation", groups, *numbers, scratch, *read, gradient, sums)
            session.finish(gradient, sums)
        of_readings, _, totals = added(sums).split([sizes[0] * sizes[1], sizes[1], 2])
        of_readings = of_readings.view(sizes[0], sizes[1])[:channels, : pictures * each].T
        ctx.save_for_backward(gradient, of_readings.reshape(readings.shape))
        return slopes @ totals

    @staticmethod
    @first_gradients_only
    def backward(ctx: Any, grad_penalty: Tensor) -> tuple[Tensor | None, ...]:
        gradients = (each * grad_penalty if needed else None for each, needed in _needed(ctx))
        return *gradients, None, None, None


def _needed(ctx: Any) -> list[tuple[Tensor, bool]]:
    return list(zip(ctx.saved_tensors, ctx.needs_input_grad[:2], strict=True))


def _layer(
    directions: Float[Tensor, "P M"], readings: Float[Tensor, "P R M"], sizes: list[int]
) -> tuple[Float[Tensor, " weights"], Float[Tensor, "passing channels"]]:
    """As the kernel has them: [channels][readings, pictures, readings' own pictures] and a bias; and of the first two
    parts, along which gradients pass back, a row for each."""
    channels, each = directions.shape[1], readings.shape[1]
    half = torch.ones_like(directions[:, :1]) / 2
    parts = [
        (readings.detach().flatten(0, 1), torch.zeros_like(half).repeat_interleave(each, dim=0)),
        (directions, half),
        (directions.repeat_interleave(each, dim=0), half.repeat_interleave(each, dim=0)),
    ]
    rows = []
    for (part, bias), size in zip(parts, (sizes[1], sizes[2], sizes[1]), strict=True):
        whole = part.new_zeros(size, sizes[0] + 1)
        whole[: len(part), :channels], whole[: len(part), -1:] = part, bias
        rows.append(whole)
    layer = torch.cat(rows)
    return layer.T.flatten(), layer[: sizes[1] + sizes[2], :-1].contiguous()
