"""Whether a message can be recognised is measured regardless of colours, beside a control: other views."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from stages.analysis.secrecy.conditions import ALL, CHANNEL, CHANNELS, LINES
from stages.analysis.secrecy.feature_map import feature_map_correlations
from stages.analysis.secrecy.linear import least_squares, multiple_correlations, neighbourhoods
from stages.analysis.secrecy.measuring import edges, luma, picture_readings
from tests.stages.analysis.secrecy.observations import smooth, views

OPENLY = torch.cat([torch.zeros(3, 3), torch.eye(3)])
"""A mixture that shows the message itself."""


def figures(readings: list[torch.Tensor], observed: list) -> dict[str, float]:
    found = [each for _, _, each in picture_readings(readings, observed)]
    return {name: float(np.mean([each[name] for each in found])) for name in found[0]}


def test_a_negative_is_recognised_and_has_no_decibels() -> None:
    observed = views(OPENLY, 4)
    negative = figures([1 - seen.truths for seen in observed], observed)
    assert negative["psnr_covered"] < negative["psnr_constant"]
    assert negative["psnr_coloured"] > 60
    assert negative["correlation"] == pytest.approx(1, abs=1e-4)
    assert negative["correlation_others"] < 0.6


def test_true_colours_are_those_of_the_covered_pixels() -> None:
    """Pixels without a message are neither fitted nor measured."""
    [seen] = views(OPENLY, 1)
    coverage, negative = seen.coverage.clone(), 1 - seen.truths
    coverage[:, :, 10:] = 0.49
    coverage[:, :, :10] = 0.5
    negative[:, :, 10:] = 0.3
    [(_, _, found)] = picture_readings([negative], [replace(seen, coverage=coverage)])
    assert found["psnr_coloured"] > 60
    assert found["psnr"] < 20


def test_what_lies_outside_the_range_of_a_screen_can_be_recognised() -> None:
    """As is, all that is brighter than white counts as white; with fitted colours, none of it is lost."""
    observed = views(OPENLY, 2)
    readings = [20 * seen.truths - 9 for seen in observed]
    found, clamped = (figures(each, observed) for each in (readings, [reading.clamp(0, 1) for reading in readings]))
    assert found["psnr"] == clamped["psnr"]
    assert found["psnr_covered"] == clamped["psnr_covered"]
    assert found["psnr_coloured"] > 60 > clamped["psnr_coloured"]
    assert found["correlation"] == pytest.approx(1, abs=1e-4)
    assert clamped["correlation"] < 0.9


def test_another_picture_is_recognised_no_more_than_others() -> None:
    generator = torch.Generator().manual_seed(9)
    observed = views(OPENLY, 12)
    other = figures([smooth(generator)[None] for _ in observed], observed)
    assert other["correlation"] == pytest.approx(other["correlation_others"], abs=0.1)


def test_one_colour_shows_nothing() -> None:
    observed = views(OPENLY, 2)
    grey = figures([torch.full_like(seen.truths, 0.4) for seen in observed], observed)
    assert grey["correlation"] == pytest.approx(0, abs=1e-3)
    assert grey["psnr_coloured"] == pytest.approx(grey["psnr_constant"], abs=1e-3)


def test_a_single_view_has_no_control() -> None:
    observed = views(OPENLY, 1)
    assert math.isnan(figures([seen.truths for seen in observed], observed)["correlation_others"])


def test_a_view_that_shows_nothing_of_the_message_has_no_figures_of_it() -> None:
    [seen] = views(OPENLY, 1)
    nothing = replace(seen, truths=torch.zeros_like(seen.truths), coverage=torch.zeros_like(seen.coverage))
    [(_, _, found)] = picture_readings([seen.truths], [nothing])
    assert all(math.isnan(value) for value in found.values()), found


def test_the_feature_map_is_correlated_with_what_it_shows() -> None:
    observed = views(OPENLY, 4)
    found = feature_map_correlations(observed)
    assert {each.line for each in found} == set(LINES)
    by_line = {line: [each for each in found if each.line == line] for line in LINES}
    for each in by_line[CHANNELS] + by_line[ALL]:
        assert each.own == pytest.approx(1, abs=1e-4)
        assert each.cover < 0.8
    for number in range(3):
        for each in by_line[CHANNEL.format(number + 1)]:
            seen = observed[each.view]
            pair = seen.rendering.feature_map[..., number], luma(seen.cover)
            of_edges = np.corrcoef(*(edges(picture).flatten() for picture in pair))[0, 1]
            assert each.cover == pytest.approx(abs(np.corrcoef(*(each.flatten() for each in pair))[0, 1]), abs=1e-5)
            assert each.edges_cover == pytest.approx(abs(of_edges), abs=1e-5)
    assert all(each.edges_own > each.edges_others for each in by_line[CHANNEL.format(1)])
    assert feature_map_correlations([]) == []


def test_least_squares_finds_a_linear_map_and_needs_something() -> None:
    generator = torch.Generator().manual_seed(0)
    picture = torch.randn(9, 8, 2, generator=generator)
    regressors = neighbourhoods(picture)
    assert regressors.shape == (9, 8, 19)
    assert torch.equal(regressors[4, 3, 4], picture[4, 3, 0])
    weights = torch.randn(19, 3, generator=generator)
    assert torch.allclose(least_squares([regressors], [regressors @ weights]), weights, atol=1e-3)
    with pytest.raises(ValueError, match="nothing"):
        least_squares([], [])


def test_multiple_correlation_of_one_regressor_is_pearsons() -> None:
    generator = np.random.default_rng(0)
    x, y = generator.normal(size=(2, 50, 40)).astype(np.float32)
    y += 0.5 * x
    found = multiple_correlations(
        neighbourhoods(torch.from_numpy(x)[..., None], 1), torch.stack([torch.from_numpy(y), torch.ones(50, 40)], -1)
    )
    assert found[0] == pytest.approx(abs(np.corrcoef(x.ravel(), y.ravel())[0, 1]), abs=1e-4)
    assert np.isnan(found[1]), "a view that shows nothing of a message is none in which nothing was found"


def test_edges_of_a_slope_are_its_steepness() -> None:
    slope = torch.arange(6.0)[None, :] * 0.5 + torch.zeros(5, 1)
    assert torch.allclose(edges(slope), torch.full((5, 6), 0.5))
