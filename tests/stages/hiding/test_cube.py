"""Origins read the same as the features, and their room ends exactly at the border of the cube."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.hiding.cube import is_cornered, origins_of, room
from stages.hiding.stored_features import FARTHEST


@settings(deadline=None)
@given(count=st.integers(0, 20), channels=st.integers(2, 24), share=st.floats(0, 1), seed=st.integers(0, 2**32 - 1))
def test_room_is_in_the_cube_and_leaves_what_is_read(count: int, channels: int, share: float, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    size = (channels, max(1, round(share * (channels - 1))))
    read = torch.linalg.qr(torch.randn(size, dtype=torch.float64, generator=generator))[0]
    features = torch.rand(count, channels, dtype=torch.float64, generator=generator) - 0.5
    origins = origins_of(features, read)
    torch.testing.assert_close(origins @ read, features @ read, rtol=0, atol=1e-6)
    directions = torch.randn(count, channels, dtype=torch.float64, generator=generator)
    directions = torch.nn.functional.normalize(directions - directions @ read @ read.T, dim=1)
    there = ~is_cornered(origins)
    farthest = (origins + directions * room(origins, directions)[:, None])[there]
    torch.testing.assert_close(farthest.abs().amax(dim=1), torch.full((len(farthest),), FARTHEST, dtype=torch.float64))


def test_at_a_corner_there_is_no_room() -> None:
    read = torch.full((4, 1), 0.5, dtype=torch.float64)
    features = torch.tensor([[0.5, 0.5, 0.5, 0.5], [0.1, -0.2, 0.3, 0.4]]).double()
    assert is_cornered(origins_of(features, read)).tolist() == [True, False]
