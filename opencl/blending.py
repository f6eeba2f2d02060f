"""Alpha blending of Gaussians into a feature map, tile by tile, with gradients."""

from __future__ import annotations

import functools
from typing import Any

import torch
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.first_gradients import first_gradients_only
from opencl.memory import as_kernels_read
from opencl.program import GROUP_SIZE, ProgramKey, Schedule
from opencl.tiling import TileLists

LARGEST_FEATURE_DIM = 64
"""Channels per pass at most. More take several passes, so that a tile's sums stay near the processor."""
_CACHED = 2**24
"""Largest picture, in bytes, that stays in a processor's caches until it is read. CPU schedule only."""
_SUM_CHUNK: dict[Schedule, int] = {"cpu": 128, "gpu": 8}
"""Gaussians per work-group of sum_gradients, as in cpu/blending_backward.cl and gpu/gradient_sums.cl."""


def _gradient_row(feature_dim: int) -> int:
    """Length of the gradient row of a (tile, Gaussian) pair, as in blending_backward.cl of both schedules."""
    return 8 + -(-feature_dim // 8) * 8


class Blend(torch.autograd.Function):
    """(means2d, absolute_gradients, records, features, background) → (feature map [H,W,M], alphas [H,W]).

    Blends front to back. The kernels read the centres from the records; means2d is an argument only to receive their
    gradient. Likewise, absolute_gradients [N,2] receives the sums, over pixels, of the absolute values of that gradient
    (None: not computed). The number of pixels in which each Gaussian is drawn is added to `pixel_counts` [N], int32
    (empty: not counted). `is_only_pass` states that no other pass blends the same records, so that torch need not sum
    their gradients.
    """

    @staticmethod
    def forward(
        ctx: Any,
        backend: Backend,
        settings: RasterSettings,
        lists: TileLists,
        size: tuple[int, int],
        pixel_counts: Tensor,
        is_only_pass: bool,
        means2d: Tensor,
        absolute_gradients: Tensor | None,
        records: Tensor,
        features: Tensor,
        background: Tensor,
    ) -> tuple[Tensor, Tensor]:
        width, height = size
        feature_map = backend.memory.empty(height, width, features.shape[1], dtype=features.dtype)
        alphas = backend.memory.empty(height, width, dtype=features.dtype)
        walked = backend.memory.empty(lists.tiles, dtype=torch.int32)
        options = {
            "LARGE_PICTURE": backend.schedule == "cpu" and feature_map.nbytes > _CACHED,
            "COUNT_PIXELS": pixel_counts.numel() > 0,
            "ABSOLUTE_GRADIENTS": absolute_gradients is not None,
        }
        chosen = tuple(name for name, wanted in options.items() if wanted)
        program = ProgramKey("blending", backend.schedule, features.dtype, settings, features.shape[1], chosen)
        with backend.session() as session:
            session.launch(
                *(program, "blend", lists.tiles, width, height, records, features, background),
                *(lists.starts, lists.entries, feature_map, alphas, walked, pixel_counts),
                group_size=GROUP_SIZE[backend.schedule],
            )
            given_map, given_alphas = session.give(feature_map, alphas)
        ctx.save_for_backward(records, features, feature_map, alphas)
        ctx.backend, ctx.program, ctx.lists, ctx.walked = backend, program, lists, walked
        ctx.is_only_pass = is_only_pass
        return given_map, given_alphas

    @staticmethod
    @first_gradients_only
    def backward(ctx: Any, grad_feature_map: Tensor, grad_alphas: Tensor) -> tuple[Any, ...]:
        records, features, feature_map, alphas = ctx.saved_tensors
        backend, program, lists = ctx.backend, ctx.program, ctx.lists
        backend.memory.refuse_copies(records, features, feature_map, alphas)
        count, feature_dim = features.shape
        height, width = alphas.shape
        group_size = GROUP_SIZE[program.schedule]
        reals = functools.partial(backend.memory.empty, dtype=features.dtype)
        gradient_rows = reals(len(lists.entries), _gradient_row(feature_dim))
        background_rows = reals(lists.tiles, feature_dim)
        grad_means2d, grad_records = reals(count, 2), reals(*records.shape)
        grad_absolute = reals(count if "ABSOLUTE_GRADIENTS" in program.options else 0, 2)
        grad_features, grad_background = reals(count, feature_dim), reals(feature_dim)
        with backend.session() as session:
            session.launch(
                *(program, "blend_backward", lists.tiles, width, height, records, features),
                *(lists.starts, lists.entries, lists.slots, ctx.walked, feature_map, alphas),
                *(as_kernels_read(grad_feature_map), as_kernels_read(grad_alphas), gradient_rows, background_rows),
                group_size=group_size,
            )
            session.launch(
                *(program, "sum_gradients", -(-count // _SUM_CHUNK[program.schedule]), count, records),
                *(lists.tile_counts, lists.first_slots, gradient_rows),
                *(grad_means2d, grad_absolute, grad_records, grad_features),
                group_size=group_size,
            )
            session.launch(
                *(program, "sum_background", 1 if program.schedule == "cpu" else feature_dim),
                *(lists.tiles, background_rows, grad_background),
                group_size=group_size,
            )
            if not ctx.is_only_pass or torch.is_anomaly_enabled():  # torch reads grad_records
                session.finish(grad_records)
            given = (grad_means2d, grad_absolute, grad_features, grad_background)
            grad_means2d, grad_absolute, grad_features, grad_background = session.give(*given)
        absolute = grad_absolute if "ABSOLUTE_GRADIENTS" in program.options else None
        return (*(None,) * 6, grad_means2d, absolute, grad_records, grad_features, grad_background)
