"""View-dependent colours from spherical harmonics: one pass over the Gaussians forward, and one backward."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.first_gradients import first_gradients_only
from opencl.memory import as_kernels_read
from opencl.program import ProgramKey
from opencl.projection import launch_size
from opencl.routes import backend_for

MAXIMUM_DEGREE = 3


def colors_of_harmonics(
    base: Float[Tensor, "N 3"],
    rest: Float[Tensor, "N K 3"],
    means: Float[Tensor, "N 3"],
    camera_centre: Float[Tensor, " 3"],
    degree: int,
) -> Float[Tensor, "N 3"]:
    """Colours as in 3DGS: max(0, 0.5 + Σ h_k Y_k(d)), where d is the direction from the camera to the Gaussian.

    `base` holds the coefficients of the constant harmonic, `rest` those of the others, of which the first
    (degree + 1)² - 1 are used. All tensors must be float32, or all float64. N = 0 gives an empty result. Gradients
    reach base, rest and means, but not camera_centre. Where the sum is below -1e-5, no gradient passes; between -1e-5
    and 0, which rounding alone can cause, it does. (3DGS passes none below 0.) The same inputs on the same device give
    the same bits.

    Raises ValueError for wrong shapes or types, and for a degree outside 0..3 or higher than `rest` has coefficients
    for.
    """
    count = len(means)
    expected = {"base": (count, 3), "means": (count, 3), "camera_centre": (3,)}
    given = {"base": base, "means": means, "camera_centre": camera_centre, "rest": rest}
    for name, shape in expected.items():
        if tuple(given[name].shape) != shape:
            raise ValueError(f"{name}: found shape {tuple(given[name].shape)}, expected {shape}")
    if rest.ndim != 3 or rest.shape[::2] != (count, 3):
        raise ValueError(f"rest: found shape {tuple(rest.shape)}, expected ({count}, K, 3)")
    if type(degree) is not int or not 0 <= degree <= MAXIMUM_DEGREE or (degree + 1) ** 2 - 1 > rest.shape[1]:
        raise ValueError(
            f"degree: found {degree}, expected 0 to {MAXIMUM_DEGREE}, of which K = {rest.shape[1]} harmonics are enough"
        )
    for name, tensor in given.items():
        if tensor.dtype != means.dtype or tensor.dtype not in (torch.float32, torch.float64):
            raise ValueError(f"{name}: found {tensor.dtype}, expected float32, or float64, for all tensors")
    backend = backend_for(means.device)
    tensors = (backend.memory.receive(tensor) for tensor in (base, rest, means, camera_centre.detach()))
    colors: Tensor = _Colors.apply(backend, degree, *tensors)
    return colors.to(means.device)


class _Colors(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, backend: Backend, degree: int, base: Tensor, rest: Tensor, means: Tensor, centre: Tensor
    ) -> Tensor:
        colors = backend.memory.empty(*base.shape, dtype=base.dtype)
        program = ProgramKey("harmonics", backend.schedule, means.dtype, RasterSettings())
        groups, group_size = launch_size(backend, len(means))
        with backend.session() as session:
            inputs = (base, rest, means, centre)
            sizes = (len(means), rest.shape[1], degree)
            session.launch(program, "colors_of_harmonics", groups, *sizes, *inputs, colors, group_size=group_size)
            (given,) = session.give(colors)
        ctx.save_for_backward(base, rest, means, centre)
        ctx.backend, ctx.program, ctx.degree = backend, program, degree
        return given

    @staticmethod
    @first_gradients_only
    def backward(ctx: Any, grad_colors: Tensor) -> tuple[Any, ...]:
        base, rest, means, centre = ctx.saved_tensors
        empty = ctx.backend.memory.empty
        gradients = [empty(*tensor.shape, dtype=means.dtype) for tensor in (base, rest, means)]
        groups, group_size = launch_size(ctx.backend, len(means))
        with ctx.backend.session() as session:
            session.launch(
                *(ctx.program, "colors_of_harmonics_backward", groups, len(means), rest.shape[1], ctx.degree),
                *(base, rest, means, centre, as_kernels_read(grad_colors), *gradients),
                group_size=group_size,
            )
            grad_base, grad_rest, grad_means = session.give(*gradients)
        return None, None, grad_base, grad_rest, grad_means, None
