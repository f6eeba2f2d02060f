from __future__ import annotations

import math

import pytest
import torch

from stages.imaging.psnr import psnr


def test_known_error() -> None:
    truth = torch.full((4, 5, 3), 0.5)
    assert psnr(truth + 0.1, truth) == pytest.approx(20, abs=1e-5)
    assert psnr(truth + 1e-5, truth) == pytest.approx(100, abs=0.1)


def test_values_beyond_the_range_count_as_its_ends() -> None:
    truth = torch.ones(2, 2, 3)
    assert psnr(torch.full((2, 2, 3), 7.0), truth) == math.inf


def test_only_masked_pixels_count() -> None:
    truth = torch.zeros(2, 4, 4, 3)
    picture = truth.clone()
    picture[1, 0, 0] = 0.1
    picture[0, 2, 2] = 1
    mask = torch.zeros(2, 4, 4, dtype=torch.bool)
    mask[1, 0, 0] = True
    assert psnr(picture, truth, mask) == pytest.approx(20, abs=1e-5)


def test_an_empty_mask_measures_nothing() -> None:
    truth = torch.zeros(3, 3, 3)
    assert math.isnan(psnr(truth, truth, torch.zeros(3, 3, dtype=torch.bool)))


@pytest.mark.parametrize("broken", [1, 12])
def test_a_broken_picture_is_not_a_perfect_one(broken: int) -> None:
    truth = torch.full((2, 2, 3), 0.5)
    picture = truth.clone()
    picture.view(-1)[:broken] = math.nan
    assert math.isnan(psnr(picture, truth))


@pytest.mark.usefixtures("any_arrays")
def test_shapes_must_agree() -> None:
    with pytest.raises(ValueError, match="one size"):
        psnr(torch.zeros(2, 2, 3), torch.zeros(2, 3, 3))
    with pytest.raises(ValueError, match="one size"):
        psnr(torch.zeros(2, 2, 3), torch.zeros(2, 2, 3), torch.zeros(2, 2, 3, dtype=torch.bool))
