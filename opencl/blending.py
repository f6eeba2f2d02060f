"""Alpha blending of the tiles' Gaussians into a feature map, with gradients."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.program import GROUP_SIZE, ProgramKey, Schedule
from opencl.tiling import TileLists

LARGEST_FEATURE_DIM = 64
"""Channels of one pass; more are blended in several, so that a tile's sums stay within the processor's caches."""
_SUM_CHUNK: dict[Schedule, int] = {"cpu": 128, "gpu": 8}
"""Gaussians a work-group of sum_gradients takes, as in cpu/blending_backward.cl and gpu/gradient_sums.cl."""


def _gradient_row(schedule: Schedule, feature_dim: int) -> int:
    """Length of a (tile, Gaussian)'s gradient row, as in the schedules' blending_backward.cl."""
    if schedule == "cpu":
        return -(-(6 + feature_dim) // 16) * 16
    return -(-(8 + feature_dim) // 8) * 8


class Blend(torch.autograd.Function):
    """(means2d, records, features, background) → (feature map [H,W,M], alphas [H,W]), front to back.

    The kernels read centres from the records; means2d is an argument so that their gradient goes to it.
    """

    @staticmethod
    def forward(
        ctx: Any,
        backend: Backend,
        settings: RasterSettings,
        lists: TileLists,
        size: tuple[int, int],
        means2d: Tensor,
        records: Tensor,
        features: Tensor,
        background: Tensor,
    ) -> tuple[Tensor, Tensor]:
        width, height = size
        feature_map = features.new_empty(height, width, features.shape[1])
        alphas = features.new_empty(height, width)
        walked = torch.empty(lists.tiles, dtype=torch.int32)
        program = ProgramKey("blending", backend.schedule, features.dtype, settings, features.shape[1])
        outputs = (feature_map, alphas, walked)
        group_size = GROUP_SIZE[backend.schedule]
        with backend.session() as session:
            inputs = (records, features, background, lists.starts, lists.entries)
            session.launch(program, "blend", lists.tiles, width, height, *inputs, *outputs, group_size=group_size)
            session.finish(*outputs)
        ctx.save_for_backward(records, features, feature_map, alphas)
        ctx.backend, ctx.program, ctx.lists, ctx.walked = backend, program, lists, walked
        return feature_map, alphas

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_feature_map: Tensor, grad_alphas: Tensor) -> tuple[Any, ...]:
        records, features, feature_map, alphas = ctx.saved_tensors
        lists: TileLists = ctx.lists
        count, feature_dim = features.shape
        height, width = alphas.shape
        schedule = ctx.backend.schedule
        group_size = GROUP_SIZE[schedule]
        gradient_rows = features.new_empty(len(lists.entries), _gradient_row(schedule, feature_dim))
        background_rows = features.new_empty(lists.tiles, feature_dim)
        grad_means2d, grad_records = features.new_empty(count, 2), torch.empty_like(records)
        grad_features, grad_background = torch.empty_like(features), features.new_empty(feature_dim)
        with ctx.backend.session() as session:
            session.launch(
                *(ctx.program, "blend_backward", lists.tiles, width, height, records, features),
                *(lists.starts, lists.entries, lists.slots, ctx.walked, feature_map, alphas),
                *(grad_feature_map.contiguous(), grad_alphas.contiguous(), gradient_rows, background_rows),
                group_size=group_size,
            )
            session.launch(
                *(ctx.program, "sum_gradients", -(-count // _SUM_CHUNK[schedule]), count, records, lists.tile_counts),
                *(lists.first_slots, gradient_rows, grad_means2d, grad_records, grad_features),
                group_size=group_size,
            )
            groups = 1 if schedule == "cpu" else feature_dim
            sums = (lists.tiles, background_rows, grad_background)
            session.launch(ctx.program, "sum_background", groups, *sums, group_size=group_size)
            session.finish(grad_means2d, grad_records, grad_features, grad_background)
        return (None, None, None, None, grad_means2d, grad_records, grad_features, grad_background)
