"""Projection of Gaussians from world space to the screen, with gradients."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterSettings, half_fields_of_view
from opencl.first_gradients import first_gradients_only
from opencl.memory import as_kernels_read
from opencl.program import GROUP_SIZE, PROJECTION_CHUNK, ProgramKey

RECORD = 8
"""Number of values that describe a Gaussian on the screen, as in real.cl."""


def pack_camera(
    world_to_camera: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    width: int,
    height: int,
    settings: RasterSettings,
) -> Float[Tensor, " 20"]:
    """The camera in the kernels' layout: rotation by rows, translation, focal lengths, principal point, clamp."""
    rows, calibration = world_to_camera.tolist(), intrinsics.tolist()
    values = [value for row in rows[:3] for value in row[:3]] + [row[3] for row in rows[:3]]
    values += [calibration[0][0], calibration[1][1], calibration[0][2], calibration[1][2]]
    values += half_fields_of_view(intrinsics, width, height, settings)
    return torch.tensor(values, dtype=world_to_camera.dtype, device="cpu")


def launch_size(backend: Backend, count: int) -> tuple[int, int]:
    """(number of work-groups, work-items per group) for `count` Gaussians."""
    group_size = GROUP_SIZE[backend.schedule]
    return -(-count // (group_size * PROJECTION_CHUNK[backend.schedule])), group_size


class Project(torch.autograd.Function):
    """(means, quats, scales, opacities, features) → (means2d [N,2], records [N,8], radii [N], depth keys [N]).

    Features only determine whether a Gaussian is finite. real.cl describes the records. Of these, slope, precisions and
    opacity have gradients; that of the centre comes through means2d.
    """

    @staticmethod
    def forward(
        ctx: Any,
        backend: Backend,
        settings: RasterSettings,
        camera: Tensor,
        size: tuple[int, int],
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        features: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        count, feature_dim = features.shape
        width, height = size
        memory = backend.memory
        means2d, records = memory.empty(count, 2, dtype=means.dtype), memory.empty(count, RECORD, dtype=means.dtype)
        radii = memory.empty(count, dtype=torch.int32)
        depth_keys = memory.empty(count, dtype=torch.int32 if means.dtype == torch.float32 else torch.int64)
        program = ProgramKey("geometry", backend.schedule, means.dtype, settings)
        inputs = (means, quats, scales, opacities, features, camera)
        outputs = (means2d, records, radii, depth_keys)
        with backend.session() as session:
            sizes = (count, feature_dim, width, height)
            groups, group_size = launch_size(backend, count)
            session.launch(program, "project", groups, *sizes, *inputs, *outputs, group_size=group_size)
            (means2d,) = session.give(means2d)
        ctx.save_for_backward(means, quats, scales, opacities, camera, records)
        ctx.backend, ctx.program = backend, program
        ctx.mark_non_differentiable(radii, depth_keys)
        ctx.set_materialize_grads(False)
        return means2d, records, radii, depth_keys

    @staticmethod
    @first_gradients_only
    def backward(ctx: Any, grad_means2d: Tensor | None, grad_records: Tensor | None, *_: None) -> tuple[Any, ...]:
        means, quats, scales, opacities, camera, records = ctx.saved_tensors
        memory, dtype = ctx.backend.memory, means.dtype
        memory.refuse_copies(records)
        grad_means2d = (
            memory.zeros(len(means), 2, dtype=dtype) if grad_means2d is None else as_kernels_read(grad_means2d)
        )
        grad_records = (
            memory.zeros(*records.shape, dtype=dtype) if grad_records is None else as_kernels_read(grad_records)
        )
        shapes = (means.shape, quats.shape, scales.shape, means.shape[:1])
        results = tuple(memory.empty(*shape, dtype=dtype) for shape in shapes)
        with ctx.backend.session() as session:
            groups, group_size = launch_size(ctx.backend, len(means))
            session.launch(
                *(ctx.program, "project_backward", groups, len(means)),
                *(means, quats, scales, opacities, camera, records, grad_means2d, grad_records, *results),
                group_size=group_size,
            )
            results = session.give(*results)
        return (None, None, None, None, *results, None)
