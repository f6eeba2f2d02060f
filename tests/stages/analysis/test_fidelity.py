"""Figures over covered pixels look only there, and the floor is the best constant."""

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
    assert figures["coverage"] == pytest.approx(0.5)


def test_the_constant_is_the_best_of_all() -> None:
    truth = torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(0))
    everywhere = torch.ones(8, 8)
    floor = covered_figures(truth, truth, everywhere)["psnr_constant"]
    for shade in torch.linspace(0, 1, 11):
        constant = shade.expand_as(truth)
        assert covered_figures(constant, truth, everywhere)["psnr_covered"] <= floor


def test_nothing_covered_is_not_a_number() -> None:
    picture = torch.zeros(12, 12, 3)
    figures = covered_figures(picture, picture, torch.zeros(12, 12))
    assert math.isnan(figures["psnr_covered"])
    assert math.isnan(figures["psnr_constant"])


@pytest.mark.parametrize("pixels", [1, 300])
def test_what_shows_one_colour_has_no_floor(pixels: int) -> None:
    """Its floor would be infinite, and with it the mean over views: of a sky, of a single pixel, of nothing at all."""
    picture, coverage = torch.rand(20, 20, 3, generator=torch.Generator().manual_seed(0)), torch.zeros(20, 20)
    truth = torch.full_like(picture, 249 / 255)
    coverage.view(-1)[:pixels] = 1
    figures = covered_figures(picture, truth, coverage)
    assert math.isnan(figures["psnr_constant"])
    assert math.isfinite(figures["psnr_covered"])


def test_pictures_are_clamped_before_they_are_measured() -> None:
    truth = torch.ones(16, 16, 3)
    assert picture_figures(truth * 1.7, truth, {})["psnr"] == math.inf
