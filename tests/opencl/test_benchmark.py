"""The benchmark's count of pairs, which reads what only the device holds elsewhere."""

from __future__ import annotations

import torch

from opencl.backend import Backend
from opencl.benchmark import Workload, _tile_lists, evaluated_pixels, make_gaussians
from opencl.device import choose_device


def test_pairs_are_counted_wherever_they_are():
    workload = Workload("small", 300, 64, 48, 3)
    found = []
    for shares_memory in (True, False):
        backend = Backend(choose_device(), shares_memory=shares_memory)
        with torch.no_grad():
            found.append(evaluated_pixels(*_tile_lists(backend, workload, make_gaussians(workload)), workload.width))
    assert found[0] == found[1] > 0
