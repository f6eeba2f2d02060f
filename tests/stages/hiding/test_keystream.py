"""Encrypted values are uniform whatever the input was, and the key restores the input."""

from __future__ import annotations

import tracemalloc

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.hiding.keystream import BLOCK, LONGEST, SHORTEST, decrypted, encrypted

KEY = bytes(range(32))


def some_values(count: int, dimensions: int = 8) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    directions = torch.randn(count, dimensions, dtype=torch.float64, generator=generator)
    lengths = torch.rand(count, dtype=torch.float64, generator=generator)
    return torch.nn.functional.normalize(directions, dim=1), lengths


@settings(deadline=None)
@given(count=st.integers(0, 30), dimensions=st.integers(1, 20), key=st.binary(max_size=40))
def test_who_has_the_key_gets_everything_back(count: int, dimensions: int, key: bytes) -> None:
    values = some_values(count, dimensions)
    closed, shares = encrypted(*values, key)
    assert ((shares >= SHORTEST) & (shares <= LONGEST)).all()
    for back, own in zip(decrypted(closed, shares, torch.arange(count), key), values, strict=True):
        torch.testing.assert_close(back, own, rtol=0, atol=1e-9)


def test_few_values_take_little_memory_however_many_their_dimensions() -> None:
    """A stranger's bundle may have one Gaussian and a thousand channels."""
    values = some_values(1, 64)
    closed = encrypted(*values, KEY)
    tracemalloc.start()
    try:
        decrypted(*closed, torch.arange(1), KEY)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1e6


def test_some_of_them_are_put_back_by_their_numbers() -> None:
    values = some_values(2 * BLOCK + 5)
    closed = encrypted(*values, KEY)
    numbers = torch.tensor([2 * BLOCK + 4, 999, 3, BLOCK, 500, 0, BLOCK - 1])
    back = decrypted(*(each[numbers] for each in closed), numbers, KEY)
    for found, own in zip(back, values, strict=True):
        torch.testing.assert_close(found, own[numbers], rtol=0, atol=1e-9)


@pytest.mark.parametrize("length", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("dimensions", [1, 2, 8])
@pytest.mark.parametrize("axis", [0, -1, None])
def test_what_comes_out_says_nothing_of_what_went_in(axis: int | None, dimensions: int, length: float) -> None:
    """All values are equal, along any direction or none; the output is uniform in direction and length."""
    count, same = 20_000, torch.zeros(dimensions, dtype=torch.float64)
    if axis is not None:
        same[axis] = 1
    elif length:
        same += dimensions**-0.5
    along, shares = encrypted(same.expand(count, -1), torch.full((count,), length, dtype=torch.float64), KEY)
    even = torch.eye(dimensions, dtype=torch.float64) / dimensions
    torch.testing.assert_close(along.norm(dim=1), torch.ones(count, dtype=torch.float64))
    torch.testing.assert_close(along.mean(dim=0), torch.zeros(dimensions, dtype=torch.float64), rtol=0, atol=0.025)
    torch.testing.assert_close(along.T @ along / count, even, rtol=0, atol=0.015)
    fourth = torch.full((dimensions,), 3 / (dimensions * (dimensions + 2)), dtype=torch.float64)
    torch.testing.assert_close((along**4).mean(dim=0), fourth, rtol=0, atol=0.01)
    steps = torch.linspace(0, 1, count, dtype=torch.float64)
    assert (((shares - SHORTEST) / (LONGEST - SHORTEST)).sort().values - steps).abs().max() < 0.015
    together = torch.corrcoef(torch.cat([along, shares[:, None]], dim=1).T)
    assert (together - torch.eye(dimensions + 1, dtype=torch.float64)).abs().max() < 0.03
    assert (along[1:] * along[:-1]).sum(dim=1).mean().abs() < 0.025, "of values beside each other"


def test_another_key_or_number_has_another_keystream() -> None:
    directions, lengths = some_values(500)
    closed = encrypted(directions, lengths, KEY)
    numbers = torch.arange(500)
    for wrong, _ in (decrypted(*closed, numbers, bytes(32)), decrypted(*closed, numbers + 1, KEY), closed):
        assert (wrong * directions).sum(dim=1).mean().abs() < 0.08


def test_a_little_noise_stays_little() -> None:
    directions, lengths = some_values(500)
    lengths[:250] = 1
    closed, shares = encrypted(directions, lengths, KEY)
    noise = 0.02 * torch.randn(500, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    back, found = decrypted(closed, shares + noise, torch.arange(500), KEY)
    assert (found - lengths).abs().max() < 0.2
    assert ((found >= 0) & (found <= 1)).all()
    torch.testing.assert_close(back, directions, rtol=0, atol=1e-9)
