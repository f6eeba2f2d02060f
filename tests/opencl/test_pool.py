"""Pooled memory is used again only once nothing can see it any more."""

from __future__ import annotations

import gc

import numpy as np
import pytest
import torch

import opencl.pool
from opencl.pool import empty
from tests.opencl.scenes import make_scene

LARGE = 2**20


@pytest.fixture(autouse=True)
def own_pool(monkeypatch):
    """A new pool, since memory that other tests left behind would be taken first."""
    monkeypatch.setattr(opencl.pool, "_pool", opencl.pool._Pool())


def test_memory_is_used_again_once_nobody_has_it():
    tensor = empty(LARGE, dtype=torch.float32)
    place = tensor.data_ptr()
    del tensor
    assert empty(LARGE, dtype=torch.float32).data_ptr() == place


def test_a_view_keeps_memory_from_others():
    tensor = empty(4, LARGE, dtype=torch.float32).fill_(7.0)
    view = tensor[1:2, ::3].detach()
    del tensor
    others = [empty(4, LARGE, dtype=torch.float32).fill_(0.0) for _ in range(3)]
    assert (view == 7.0).all()
    assert len({other.data_ptr() for other in others}) == 3


def test_memory_of_another_type_and_a_little_more_of_it_will_do():
    tensor = empty(LARGE, dtype=torch.float64)
    place = tensor.data_ptr()
    del tensor
    smaller = empty(2 * LARGE - 5, dtype=torch.int32)
    assert smaller.data_ptr() == place
    assert smaller.shape == (2 * LARGE - 5,)
    assert empty(LARGE // 2, dtype=torch.float32).data_ptr() != place


def test_tensors_begin_with_a_cache_line():
    sizes = (LARGE, LARGE + 1, 3 * LARGE // 2)
    assert all(empty(size, dtype=torch.float32).data_ptr() % 64 == 0 for size in sizes)


def test_no_more_is_kept_than_was_said(monkeypatch):
    monkeypatch.setattr(opencl.pool, "_KEPT", 10 * LARGE)
    tensors = [empty(LARGE, dtype=torch.float32) for _ in range(8)]
    del tensors
    gc.collect()
    assert sum(block.nbytes for block in opencl.pool._pool._blocks) <= 10 * LARGE


def test_a_picture_outlives_those_that_follow():
    scene = make_scene(count=200, feature_dim=16, width=160, height=120, dtype=torch.float32)
    first = scene.draw().features
    kept = first.clone()
    for _ in range(3):
        scene.opacities.mul_(0.5)
        scene.draw()
    assert torch.equal(first, kept)


def test_a_release_may_interrupt_a_take():
    """The garbage collector may cause one between any two steps of a take."""
    pool = opencl.pool._pool
    held = [empty(LARGE, dtype=torch.float32) for _ in range(6)]
    del held[:3]

    class Block(np.ndarray):
        """Releases tensors while it is inspected."""

        @property
        def nbytes(self) -> int:
            held.clear()
            return int(super().nbytes)

    pool._blocks[0] = pool._blocks[0].view(Block)
    assert pool.take(100 * LARGE).nbytes == 100 * LARGE  # larger than any block, so all are inspected
    assert len(pool._blocks) == 6
