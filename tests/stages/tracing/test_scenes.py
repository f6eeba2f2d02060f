"""Each built-in scene fills every picture, is deep, has many features for SIFT, and looks like no other."""

from __future__ import annotations

import importlib
from functools import cache
from typing import get_args

import cv2
import numpy as np
import pytest

from stages.synthesize import SynthesizeParameters
from stages.tracing.photograph import Studio
from stages.tracing.photograph_process import SCENES
from stages.tracing.rig import orbit
from stages.tracing.world import World

NAMES = get_args(SynthesizeParameters.model_fields["scene"].annotation)
QUICKEST = "courtyard"
VIEWS = (3, 21, 38)
WIDTH, HEIGHT = 256, 192


def build(name: str, seed: int) -> World:
    return importlib.import_module(f"{SCENES}.{name}").build(seed)


@cache
def world(name: str) -> World:
    return build(name, 0)


@cache
def place(name: str) -> Studio:
    return Studio(world(name))


@cache
def pictures(name: str) -> np.ndarray:
    poses, intrinsics = orbit(48, WIDTH, HEIGHT, 0)
    return np.stack(
        [
            place(name).photograph(poses[view], intrinsics[view], WIDTH, HEIGHT, 4, np.random.default_rng(view))
            for view in VIEWS
        ]
    )


def palette_of(picture: np.ndarray) -> np.ndarray:
    """The share of pixels in each of 64 colours."""
    cells = (picture.reshape(-1, 3) // 64).astype(int) @ [16, 4, 1]
    return np.bincount(cells, minlength=64) / len(cells)


EVERY_SCENE = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == QUICKEST else pytest.mark.slow) for name in NAMES]
)
"""The others take ten seconds each to be built, and nobody edits them."""


@EVERY_SCENE
def test_every_ray_of_every_camera_meets_something_in_front_of_the_lens(name: str) -> None:
    poses, intrinsics = orbit(48, 48, 36, 0)
    y, x = np.mgrid[:36, :48] + 0.5
    depths = np.stack(
        [
            place(name).depth(pose, matrix, np.stack([x.ravel(), y.ravel()]).astype(np.float32))
            for pose, matrix in zip(poses, intrinsics, strict=True)
        ]
    )
    assert np.isfinite(depths).all()
    assert depths.min() > 0.15
    near, far = np.quantile(depths, [0.02, 0.98])
    assert far / near > 3


@EVERY_SCENE
def test_pictures_are_neither_burnt_nor_dark_and_have_fine_and_coarse_detail(name: str) -> None:
    grey = pictures(name).mean(axis=-1) / 255
    assert 0.2 < grey.mean() < 0.75
    assert grey.std() > 0.12
    assert (grey > 0.98).mean() < 0.02
    for halvings in (1, 2, 4):
        small = grey.reshape(len(VIEWS), HEIGHT // halvings, halvings, WIDTH // halvings, halvings).mean(axis=(2, 4))
        assert np.abs(np.diff(small, axis=2)).mean() > 0.02


@EVERY_SCENE
def test_sift_finds_plenty(name: str) -> None:
    counts = [len(cv2.SIFT_create().detect(cv2.cvtColor(shown, cv2.COLOR_RGB2GRAY))) for shown in pictures(name)]
    assert min(counts) > 400


@pytest.mark.slow
def test_no_two_scenes_share_a_palette() -> None:
    palettes = {name: np.mean([palette_of(shown) for shown in pictures(name)], axis=0) for name in NAMES}
    assert len(NAMES) >= 4
    for first in NAMES:
        for second in NAMES:
            if first < second:
                assert np.abs(palettes[first] - palettes[second]).sum() / 2 > 0.3, (first, second)


@pytest.mark.slow
def test_the_seed_changes_a_scene_s_paint() -> None:
    first, again, other = world("courtyard"), build("courtyard", 0), build("courtyard", 1)
    assert all(np.array_equal(one, two) for one, two in zip(first.pages, again.pages, strict=True))
    assert not any(np.array_equal(one, two) for one, two in zip(first.pages, other.pages, strict=True))
