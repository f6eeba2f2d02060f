"""Alpha blending of the tiles' Gaussians into a feature map, with gradients."""

from __future__ import annotations

import functools
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.program import ProgramKey
from opencl.tiling import TileLists

LARGEST_FEATURE_DIM = 64
"""Channels of one pass; more are blended in several, so that a tile's sums stay within the processor's caches."""
_CACHED = 2**24
"""Bytes of a picture that stays in the processor's caches until it is read."""
_SUM_CHUNK = 128
"""Gaussians a work-item of sum_gradients takes, as in blending_backward.cl."""


def _gradient_row(feature_dim: int) -> int:
    """Length of a (tile, Gaussian)'s gradient row, as in blending_backward.cl."""
    return 8 + -(-feature_dim // 8) * 8


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
        feature_map = backend.memory.empty(height, width, features.shape[1], dtype=features.dtype)
        alphas = backend.memory.empty(height, width, dtype=features.dtype)
        walked = backend.memory.empty(lists.tiles, dtype=torch.int32)
        options = ("LARGE_PICTURE",) if feature_map.nbytes > _CACHED else ()
        program = ProgramKey("blending", backend.schedule, features.dtype, settings, features.shape[1], options)
        outputs = (feature_map, alphas, walked)
        with backend.session() as session:
            inputs = (records, features, background, lists.starts, lists.entries)
            session.launch(program, "blend", lists.tiles, width, height, *inputs, *outputs)
            given_map, given_alphas = session.give(feature_map, alphas)
        ctx.save_for_backward(records, features, feature_map, alphas)
        ctx.backend, ctx.program, ctx.lists, ctx.walked = backend, program, lists, walked
        return given_map, given_alphas

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_feature_map: Tensor, grad_alphas: Tensor) -> tuple[Any, ...]:
        records, features, feature_map, alphas = ctx.saved_tensors
        lists: TileLists = ctx.lists
        count, feature_dim = features.shape
        height, width = alphas.shape
        reals = functools.partial(ctx.backend.memory.empty, dtype=features.dtype)
        gradient_rows = reals(len(lists.entries), _gradient_row(feature_dim))
        background_rows = reals(lists.tiles, feature_dim)
        grad_means2d, grad_records = reals(count, 2), reals(*records.shape)
        grad_features, grad_background = reals(count, feature_dim), reals(feature_dim)
        with ctx.backend.session() as session:
            session.launch(
                *(ctx.program, "blend_backward", lists.tiles, width, height, records, features),
                *(lists.starts, lists.entries, lists.slots, ctx.walked, feature_map, alphas),
                *(grad_feature_map.contiguous(), grad_alphas.contiguous(), gradient_rows, background_rows),
            )
            session.launch(
                *(ctx.program, "sum_gradients", -(-count // _SUM_CHUNK), count, records, lists.tile_counts),
                *(lists.first_slots, gradient_rows, grad_means2d, grad_records, grad_features),
            )
            session.launch(ctx.program, "sum_background", 1, lists.tiles, background_rows, grad_background)
            session.finish(grad_records)  # torch sums those of several passes
            grad_means2d, grad_features, grad_background = session.give(grad_means2d, grad_features, grad_background)
        return (None, None, None, None, grad_means2d, grad_records, grad_features, grad_background)
