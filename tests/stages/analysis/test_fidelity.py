"""Figures over covered pixels ignore all others, and the floor is that of the best constant."""

from __future__ import annotations

import math

import pytest
import torch

from stages.analysis.fidelity import covered_figures, picture_figures


def test_only_covered_pixels_count() -> None:
    truth = torch.rand(20, 20, 3, generator=torch.Generator().manual_seed(0))
    coverage = torch.zeros(20, 20)
    coverage[:, :10] = 1
    picture = truth.clone()
    picture[:, 10:] = 0
    figures = covered_figures(picture, truth, coverage)
    assert figures["psnr_covered"] == math.inf


def test_similarity_is_that_of_covered_pixels() -> None:
    """The wrong pixels lie beyond the reach of the windows around covered ones."""
    truth = torch.rand(20, 20, 3, generator=torch.Generator().manual_seed(0))
    picture, coverage = truth.clone(), torch.zeros(20, 20)
    picture[:, 10:] = 0
    coverage[:, :5] = 1
    assert covered_figures(picture, truth, coverage)["ssim_covered"] == pytest.approx(1)


def test_a_pixel_is_covered_where_the_message_fills_at_least_half_of_it() -> None:
    truth = torch.rand(20, 20, 3, generator=torch.Generator().manual_seed(0))
    coverage = torch.full((20, 20), 0.49)
    coverage[:, :10] = 0.5
    right_on_the_left, right_on_the_right = truth.clone(), truth.clone()
    right_on_the_left[:, 10:] = 0
    right_on_the_right[:, :10] = 0
    assert covered_figures(right_on_the_left, truth, coverage)["psnr_covered"] == math.inf
    assert covered_figures(right_on_the_right, truth, coverage)["psnr_covered"] < 20


def test_the_constant_is_the_best_of_all() -> None:
    truth = torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(0))
    left = torch.zeros(8, 8)
    left[:, :4] = 1
    truth[:, :4] /= 2
    floor = covered_figures(truth, truth, left)["psnr_constant"]
    for shade in torch.linspace(0, 1, 101):
        constant = shade.expand_as(truth)
        assert covered_figures(constant, truth, left)["psnr_covered"] <= floor


def test_nothing_covered_is_not_a_number() -> None:
    picture = torch.zeros(12, 12, 3)
    figures = covered_figures(picture, picture, torch.zeros(12, 12))
    assert math.isnan(figures["psnr_covered"])
    assert math.isnan(figures["psnr_constant"])


@pytest.mark.parametrize("pixels", [1, 300])
def test_what_shows_one_colour_has_no_floor(pixels: int) -> None:
    """The floor of a sky or of a single pixel would be infinite, and so would the mean over views."""
    picture, coverage = torch.rand(20, 20, 3, generator=torch.Generator().manual_seed(0)), torch.zeros(20, 20)
    truth = torch.full_like(picture, 249 / 255)
    coverage.view(-1)[:pixels] = 1
    figures = covered_figures(picture, truth, coverage)
    assert math.isnan(figures["psnr_constant"])
    assert math.isfinite(figures["psnr_covered"])


@pytest.mark.parametrize(("shown", "rendered"), [(0.0, -0.7), (1.0, 1.7)])
def test_pictures_are_clamped_before_they_are_measured(shown: float, rendered: float) -> None:
    truth = torch.full((16, 16, 3), shown)
    picture = torch.full_like(truth, rendered)
    farthest = {"farthest": lambda one, other: float((one - other).abs().max())}
    assert picture_figures(picture, truth, farthest) == {"psnr": math.inf, "ssim": pytest.approx(1), "farthest": 0}
    covered = covered_figures(picture, truth, torch.ones(16, 16))
    assert (covered["psnr_covered"], covered["ssim_covered"]) == (math.inf, pytest.approx(1))
