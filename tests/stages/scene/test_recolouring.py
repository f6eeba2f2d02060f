"""Recolouring harmonics gives the same as recolouring the colours that they describe."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stages.scene.recolouring import LUMINANCE, recoloured, recolouring
from stages.scene.spherical_harmonics import harmonics

NONE = {"hue": 0.0, "saturation": 1.0, "tint": (1.0, 1.0, 1.0), "strength": 0.0}


def matrix(**changes: object) -> np.ndarray:
    return recolouring(**(NONE | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "change", [{}, {"hue": 120.0}, {"saturation": 0.3}, {"tint": (1.0, 0.2, 0.0), "strength": 0.7}]
)
def test_harmonics_give_the_changed_colours_in_every_direction(change: dict[str, object]) -> None:
    random = np.random.default_rng(0)
    base, rest = torch.from_numpy(random.normal(size=(6, 3))), torch.from_numpy(random.normal(size=(6, 15, 3)))
    directions = torch.nn.functional.normalize(torch.from_numpy(random.normal(size=(20, 3))), dim=1)

    def colours(base: torch.Tensor, rest: torch.Tensor) -> torch.Tensor:
        every = torch.cat([base[:, None], rest], dim=1)
        return 0.5 + torch.einsum("dk,nkc->ndc", harmonics(directions, 3), every)

    expected = colours(base, rest) @ torch.from_numpy(matrix(**change)).T
    torch.testing.assert_close(colours(*recoloured(base, rest, matrix(**change))), expected, atol=1e-12, rtol=0)


def test_nothing_changes_nothing() -> None:
    np.testing.assert_allclose(matrix(), np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrix(hue=360.0), np.eye(3), atol=2e-3)


@pytest.mark.parametrize("hue", [40.0, 180.0, -75.0])
def test_hues_keep_grey_and_luminance(hue: float) -> None:
    np.testing.assert_allclose(matrix(hue=hue) @ np.ones(3), 1, atol=2e-3)
    np.testing.assert_allclose(LUMINANCE @ matrix(hue=hue), LUMINANCE, atol=2e-3)


def test_hues_are_those_of_css() -> None:
    """hue-rotate(90deg) of pure red, as the specification's matrix gives it."""
    np.testing.assert_allclose(matrix(hue=90.0) @ [1, 0, 0], [0.213 - 0.213, 0.213 + 0.143, 0.213 - 0.787], atol=1e-9)


def test_without_saturation_all_is_grey_and_a_full_tint_leaves_its_shades() -> None:
    colour = np.array([0.9, 0.3, 0.1])
    np.testing.assert_allclose(matrix(saturation=0.0) @ colour, LUMINANCE @ colour, atol=1e-12)
    tinted = matrix(tint=(1.0, 0.5, 0.0), strength=1.0) @ colour
    np.testing.assert_allclose(tinted, (LUMINANCE @ colour) * np.array([1.0, 0.5, 0.0]), atol=1e-12)
    others = matrix(hue=90.0, saturation=3.0, tint=(1.0, 0.5, 0.0), strength=1.0) @ colour
    np.testing.assert_allclose(others, tinted, atol=2e-3, err_msg="whatever else is done to hues")
