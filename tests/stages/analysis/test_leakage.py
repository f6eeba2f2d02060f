"""The leak detector finds a message that shines through, and nothing where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stages.analysis.leakage import correlation, matched_correlations


def pictures(seed: int, count: int = 6) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    return list(generator.uniform(0, 1, (count, 16, 16, 3)))


def test_a_message_that_shines_through_is_seen() -> None:
    messages = pictures(0)
    noise = pictures(1)
    own, others = matched_correlations([0.1 * m + 0.02 * n for m, n in zip(messages, noise, strict=True)], messages)
    assert min(own) > 0.9
    assert max(others) < 0.2


def test_a_message_that_shines_through_in_negative_is_seen_as_well() -> None:
    residuals, messages = pictures(1), pictures(0)
    shown = [0.02 * residual - 0.1 * message for residual, message in zip(residuals, messages, strict=True)]
    own, others = matched_correlations(shown, messages)
    assert min(own) > 0.9
    assert others == pytest.approx(matched_correlations([-residual for residual in shown], messages)[1])


def test_independent_residuals_correlate_no_more_with_their_own() -> None:
    own, others = matched_correlations(pictures(2, 40), pictures(3, 40))
    assert np.mean(own) == pytest.approx(np.mean(others), abs=0.02)


def test_correlations_are_those_of_every_pair_by_itself() -> None:
    """Bytes and floats give the same correlations."""
    residuals = pictures(4)
    messages = [np.round(255 * picture).astype(np.uint8) for picture in pictures(5)]
    own, others = matched_correlations(residuals, messages)
    pairs = np.abs([[correlation(residual, message / 255) for message in messages] for residual in residuals])
    assert own == pytest.approx(np.diag(pairs), abs=1e-6)
    assert others == pytest.approx((pairs.sum(axis=1) - np.diag(pairs)) / 5, abs=1e-6)


def test_a_constant_picture_has_no_correlation() -> None:
    assert math.isnan(correlation(np.ones((4, 4, 3)), np.arange(48.0).reshape(4, 4, 3)))


@pytest.mark.parametrize("blank", [1, 2])
def test_views_that_show_nothing_of_the_message_are_no_control(blank: int) -> None:
    residuals, messages = pictures(2), pictures(3)
    _, without = matched_correlations(residuals[blank:], messages[blank:])
    own, others = matched_correlations(residuals, [np.zeros((16, 16, 3))] * blank + messages[blank:])
    assert others[blank:] == pytest.approx(without)
    assert all(math.isnan(value) for value in own[:blank])


def test_a_single_view_has_no_control() -> None:
    _, others = matched_correlations(pictures(0, 1), pictures(1, 1))
    assert math.isnan(others[0])
