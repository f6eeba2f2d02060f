"""SSIM against its definition, written out with plain convolutions, and its gradient against finite differences."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from stages.imaging.ssim import blur, ssim, ssim_map


def textbook(picture: Tensor, truth: Tensor) -> Tensor:
    """SSIM by Wang et al. (2004), window by window, for one [H, W, 3] picture."""
    offsets = torch.arange(11, dtype=picture.dtype) - 5
    line = torch.exp(-(offsets**2) / (2 * 1.5**2))
    window = line[:, None] * line / line.sum() ** 2
    padded = [torch.nn.functional.pad(each, (0, 0, 5, 5, 5, 5)) for each in (picture, truth)]
    x, y = (each.unfold(0, 11, 1).unfold(1, 11, 1) for each in padded)

    def mean(values: Tensor) -> Tensor:
        return (values * window).sum((-1, -2))

    variance_x, variance_y = mean(x * x) - mean(x) ** 2, mean(y * y) - mean(y) ** 2
    covariance = mean(x * y) - mean(x) * mean(y)
    luminance = (2 * mean(x) * mean(y) + 0.0001) / (mean(x) ** 2 + mean(y) ** 2 + 0.0001)
    return luminance * (2 * covariance + 0.0009) / (variance_x + variance_y + 0.0009)


def pair(*shape: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    picture = torch.rand(*shape, 3, dtype=torch.float64, generator=generator)
    noise = torch.rand(*shape, 3, dtype=torch.float64, generator=generator)
    return picture, 0.6 * picture + 0.4 * noise


def test_agrees_with_the_definition_at_every_pixel() -> None:
    picture, truth = pair(13, 17)
    torch.testing.assert_close(ssim_map(picture, truth), textbook(picture, truth), rtol=0, atol=1e-12)
    torch.testing.assert_close(ssim(picture, truth), textbook(picture, truth).mean(), rtol=0, atol=1e-12)


def test_gradient_with_respect_to_the_picture() -> None:
    picture, truth = pair(7, 6)
    assert torch.autograd.gradcheck(ssim, (picture.requires_grad_(), truth))


def test_a_batch_is_its_pictures_one_by_one() -> None:
    picture, truth = pair(2, 3, 12, 14)
    single = torch.stack([ssim_map(*each) for each in zip(picture.flatten(0, 1), truth.flatten(0, 1), strict=True)])
    assert torch.equal(ssim_map(picture, truth).flatten(0, 1), single)


def test_float32_follows_float64() -> None:
    picture, truth = pair(40, 30)
    assert float(ssim(picture.float(), truth.float())) == pytest.approx(float(ssim(picture, truth)), abs=1e-6)


def test_equal_pictures_and_opposite_ones() -> None:
    picture, _ = pair(16, 16)
    assert float(ssim(picture, picture)) == pytest.approx(1, abs=1e-12)
    assert float(ssim(picture, 1 - picture)) < 0


def test_blur_is_its_own_adjoint_and_pads_with_zeros() -> None:
    one, other = pair(9, 20)
    torch.testing.assert_close((blur(one) * other).sum(), (one * blur(other)).sum())
    corner = blur(torch.ones(30, 30, 1, dtype=torch.float64))
    assert float(corner[15, 15, 0]) == pytest.approx(1)
    assert float(corner[0, 0, 0]) < 0.5


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize(
    "other", [torch.zeros(8, 9, 3), torch.zeros(8, 8, 3, dtype=torch.float64)], ids=["shape", "type"]
)
def test_unlike_pictures_are_refused(other: Tensor) -> None:
    for compare in (ssim, ssim_map):
        with pytest.raises(ValueError, match="alike in shape, type and device"):
            compare(torch.zeros(8, 8, 3), other)
