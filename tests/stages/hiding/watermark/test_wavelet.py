"""The wavelet transform loses nothing and preserves lengths, whatever the picture."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.hiding.watermark.wavelet import haar, inverse_haar


def pictures(batch: int, height: int, width: int, seed: int) -> torch.Tensor:
    return torch.rand(batch, 3, height, width, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2), st.integers(1, 5), st.integers(1, 5), st.integers(0, 99))
def test_the_transform_is_orthonormal_and_inverted(batch: int, rows: int, columns: int, seed: int) -> None:
    picture = pictures(batch, 2 * rows, 2 * columns, seed)
    coefficients = haar(picture)
    assert coefficients.shape == (batch, 12, rows, columns)
    torch.testing.assert_close(coefficients.square().sum(), picture.square().sum())
    torch.testing.assert_close(inverse_haar(coefficients), picture, rtol=0, atol=1e-15)


def test_a_flat_picture_has_means_alone() -> None:
    coefficients = haar(torch.full((1, 3, 4, 6), 0.25))
    assert (coefficients[:, :3] == 0.5).all()
    assert (coefficients[:, 3:] == 0).all()


def test_each_band_answers_to_its_own_pattern() -> None:
    columns = torch.tensor([1.0, -1.0]).repeat(2).expand(4, 4)
    for band, pattern in ((1, columns), (2, columns.T), (3, columns * columns.T)):
        energy = haar(pattern.expand(1, 1, 4, 4)).square().sum(dim=(0, 2, 3))
        assert energy.nonzero().flatten().tolist() == [band]


def test_odd_sides_and_broken_bands_are_refused() -> None:
    with pytest.raises(ValueError, match="even sides, not 5 x 4"):
        haar(torch.zeros(1, 3, 4, 5))
    with pytest.raises(ValueError, match="6 channels"):
        inverse_haar(torch.zeros(1, 6, 2, 2))
