"""What a seal leaves in the clear is what the scene decoder reads of what the message decoder reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from stages.hiding.coupled import FEATURES
from stages.hiding.left_open import share_left_open
from stages.scene.gaussians import Gaussians, gaussians_at

CHANNELS, READ = 8, 3


@dataclass(frozen=True)
class Decoders:
    """The scene decoder reads the first channels; half of the Gaussians belong to the cover."""

    of_messages: Tensor

    def rows_read(self) -> Tensor:
        return torch.eye(CHANNELS)[:READ]

    def rows_of_messages(self) -> Tensor:
        return self.of_messages

    def cover_shares(self, gaussians: Gaussians) -> Tensor:
        return torch.arange(len(gaussians)) % 2 * 1.0


def gaussians(count: int) -> Gaussians:
    values = np.random.default_rng(0).uniform(0.2, 0.8, (count, CHANNELS))
    values[1::2] = 0.5  # the cover's, which do not count
    raw = torch.as_tensor(values, dtype=torch.float32).logit()
    return gaussians_at(np.zeros((count, 3), np.float32), {FEATURES: raw})


@pytest.mark.parametrize("in_read", [0, 1, 2, 4])
def test_the_share_is_that_of_the_rows_that_both_decoders_read(in_read: int) -> None:
    """Of four of equal weight, along channels that vary alike and on their own."""
    rows = torch.eye(CHANNELS)[[*range(min(in_read, READ))] + [0] * max(0, in_read - READ) + [*range(4, 8 - in_read)]]
    assert share_left_open(gaussians(20_000), Decoders(rows)) == pytest.approx(in_read / 4, abs=0.01)


def test_rows_that_lean_towards_what_is_read_count_by_how_much() -> None:
    rows = torch.zeros(1, CHANNELS)
    rows[0, 0], rows[0, 4] = 0.6, 0.8
    assert share_left_open(gaussians(20_000), Decoders(rows)) == pytest.approx(0.36, abs=0.01)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_where_nothing_varies_nothing_is_left_open(count: int) -> None:
    assert share_left_open(gaussians(count), Decoders(torch.eye(CHANNELS)[:1])) == 0
