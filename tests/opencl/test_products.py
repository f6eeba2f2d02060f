"""The number of work-items of the decoders' kernels: it depends on the processor, unless that would change bits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from opencl.products import added, summing_items, work_items


def processor(cores: int) -> Any:
    """The part of a backend that is used."""
    return SimpleNamespace(device=SimpleNamespace(handle=SimpleNamespace(max_compute_units=cores)))


@pytest.mark.parametrize(("cores", "chunks", "items"), [(1, 5, 5), (1, 50, 8), (64, 50, 50), (64, 5000, 128)])
def test_a_processor_of_many_cores_has_work_for_all_of_them(cores: int, chunks: int, items: int) -> None:
    assert work_items(processor(cores), chunks) == items


def test_sums_have_as_many_parts_on_any_processor() -> None:
    assert [summing_items(chunks) for chunks in (0, 5, 5000)] == [0, 5, 8]


def test_parts_are_added_in_their_order() -> None:
    """The first 1 is lost in 2^30; the last is added once that has cancelled."""
    parts = torch.tensor([[1.0], [2.0**30], [-(2.0**30)], [1.0]]).expand(4, 70)
    assert added(parts).tolist() == [1.0] * 70


def test_no_parts_are_nothing() -> None:
    assert added(torch.empty(0, 3)).tolist() == [0, 0, 0]
