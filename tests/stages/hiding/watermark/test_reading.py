"""Pictures made without the coins score as chance does; pictures of a container with grain score far higher."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from jaxtyping import Float
from torch import Tensor

from stages.hiding.rendering import splat
from stages.hiding.watermark.coins import DECOYS, standard_score, thrown, with_decoys
from stages.hiding.watermark.colors import COLORS, GRAIN
from stages.hiding.watermark.grain import grained
from stages.hiding.watermark.reading import CERTAIN, GrainReader, is_colorless
from stages.imaging.distortions import jpeg, noisy
from stages.imaging.pictures import Picture, resize_picture, through_jpeg
from stages.scene.cameras import single_cameras
from tests.stages.hiding.relocalisation.scenes import HEIGHT, WIDTH, beside, cloud, photograph, rig

GAUSSIANS, METHOD = cloud()
RIG = rig()
SECRET = 11


def throws(seed: int) -> Float[Tensor, "N K"]:
    """Coins and decoys drawn from a seed in place of a key."""
    return with_decoys(len(GAUSSIANS), np.random.default_rng(seed))


COINS = thrown(len(GAUSSIANS), np.random.default_rng(SECRET))
FRAMES = [((128, 96), 24, 0, 0), ((384, 288), 0, 100, 0), ((256, 192), 60, 60, 255)]
"""Size of the picture in it, how wide the frame is above and below, left and right, and its colour."""


def dither() -> np.random.Generator:
    return np.random.default_rng(12)


@cache
def reader() -> GrainReader:
    return GrainReader(GAUSSIANS, METHOD, RIG, throws(SECRET))


@cache
def marked_render() -> Picture:
    return photograph(grained(GAUSSIANS, METHOD, RIG, 2.0, COINS, dither()), METHOD, beside(RIG))


@cache
def clean_render() -> Picture:
    return photograph(GAUSSIANS, METHOD, beside(RIG))


def test_chance_has_mean_zero_and_deviation_one() -> None:
    """For any picture: noise, a render of the scene itself, and one of another scene."""
    camera = single_cameras(beside(RIG))[0]
    noise = np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    other, method = cloud(seed=5)
    for picture in (noise, photograph(GAUSSIANS, METHOD, beside(RIG)), photograph(other, method, beside(RIG))):
        scores = [standard_score(picture, GAUSSIANS, METHOD, camera, throws(seed)) for seed in range(60)]
        assert abs(np.mean(scores)) < 4 / np.sqrt(len(scores))
        assert 0.7 < np.std(scores) < 1.4
        assert max(scores) < CERTAIN


def test_grain_is_found_by_who_knows_the_coins() -> None:
    picture = photograph(grained(GAUSSIANS, METHOD, RIG, 2.0, COINS, dither()), METHOD, beside(RIG))
    assert reader().score(picture) > 2 * CERTAIN
    assert reader().certainty(picture) > 0.99
    generator = np.random.default_rng(0)
    for distortion in (jpeg(90), jpeg(70), jpeg(50, full_color=True), noisy(5.0)):
        assert reader().score(distortion.apply(picture, generator)) > CERTAIN
    another = GrainReader(GAUSSIANS, METHOD, RIG, throws(SECRET + 1))
    assert abs(another.score(picture)) < 5
    assert reader().score(picture) == reader().score(picture)


@pytest.mark.parametrize(("contrast", "brightness"), [(0.5, 60), (0.3, 0)])
def test_brightness_and_contrast_are_fitted_before_the_render_is_subtracted(contrast: float, brightness: int) -> None:
    """Left as they are, the score falls from 12.9 to below 2."""
    camera = single_cameras(beside(RIG))[0]
    changed = np.rint(contrast * marked_render() + brightness).astype(np.uint8)
    scores = [standard_score(seen, GAUSSIANS, METHOD, camera, throws(SECRET)) for seen in (marked_render(), changed)]
    assert scores[1] == pytest.approx(scores[0], rel=0.1)


@pytest.mark.parametrize(("known", "drowns"), [(SECRET, True), (SECRET + 1, False), (SECRET + 2, False)])
def test_a_grain_drowns_in_no_decoys_but_its_own(known: int, drowns: bool) -> None:
    """Those who know the source but not the key can add decoys of their own; only the owner's would hide the grain."""
    camera = single_cameras(beside(RIG))[0]
    decoys = splat(GAUSSIANS, throws(known)[:, 1:].contiguous(), camera).feature_map.double().numpy()
    pattern = decoys @ np.random.default_rng(0).choice([-1.0, 1.0], DECOYS)
    change = 4.0 * pattern / pattern.std()  # levels of 255
    marked = photograph(grained(GAUSSIANS, METHOD, RIG, 2.0, COINS, dither()), METHOD, beside(RIG))
    changed = np.clip(np.rint(marked + change[..., None] * COLORS[GRAIN].double().numpy()), 0, 255).astype(np.uint8)
    score = standard_score(changed, GAUSSIANS, METHOD, camera, reader().throws)
    assert (score < CERTAIN) == drowns


def test_what_has_no_grain_shows_nothing() -> None:
    clean = photograph(GAUSSIANS, METHOD, beside(RIG))
    assert abs(reader().score(clean)) < 5
    stranger, method = cloud(seed=7)
    assert reader().score(photograph(stranger, method, RIG.select(["0"]))) == 0
    for seed in range(4):  # by chance, a camera is found for some of them
        noise = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
        assert abs(reader().score(noise)) < 5
    assert reader().certainty(np.zeros((HEIGHT, WIDTH, 3), np.uint8)) == pytest.approx(0, abs=0.01)


@pytest.mark.parametrize("size", [(77, 58), (64, 48), (51, 38), (384, 288)])
def test_grain_is_found_in_pictures_of_another_size(size: tuple[int, int]) -> None:
    """A camera is found in a reduced picture as it is, too, with the focal length of the rig, where no grain is."""
    assert reader().score(resize_picture(marked_render(), *size)) > CERTAIN
    assert abs(reader().score(resize_picture(clean_render(), *size))) < 5


@pytest.mark.parametrize("window", [np.s_[10:82, 20:116], np.s_[24:72, 32:96]])
def test_grain_is_found_in_a_window(window: tuple[slice, slice]) -> None:
    assert reader().score(marked_render()[window].copy()) > CERTAIN


@pytest.mark.parametrize("quarters", [0, 1])
def test_grain_is_found_in_a_mirrored_or_turned_picture(quarters: int) -> None:
    for part in (np.s_[:, ::-1], np.s_[10:82, 116:20:-1], np.s_[:, :]):
        marked, clean = (np.rot90(picture[part], quarters).copy() for picture in (marked_render(), clean_render()))
        assert reader().score(marked) > CERTAIN
        assert abs(reader().score(clean)) < 5


@pytest.mark.parametrize(("size", "above", "left", "color"), FRAMES)
def test_a_frame_of_one_colour_hides_no_grain(size: tuple[int, int], above: int, left: int, color: int) -> None:
    """Letterboxed, pillarboxed or on a page, no grain is found at the middle and the size of the whole file."""
    marked, clean = (
        np.pad(resize_picture(picture, *size), ((above, above), (left, left), (0, 0)), constant_values=color)
        for picture in (marked_render(), clean_render())
    )
    assert reader().score(marked) > CERTAIN
    assert reader().score(through_jpeg(marked, 95)) > CERTAIN
    assert abs(reader().score(clean)) < 5


def test_a_scene_before_a_background_of_one_colour_needs_none_of_it() -> None:
    """Cutting the background off would lose how far away an object is, and where in the picture."""
    pose = beside(RIG).world_to_camera.copy()
    pose[0, :3, 3] += 1.2, 0.6, 1.0
    picture = photograph(
        grained(GAUSSIANS, METHOD, RIG, 3.0, COINS, dither()), METHOD, replace(beside(RIG), world_to_camera=pose)
    )
    for size in ((512, 384), (128, 96), (72, 54)):
        assert reader().score(resize_picture(picture, *size)) > CERTAIN


def test_what_has_no_colour_tells_nothing() -> None:
    grey = np.repeat(marked_render()[..., 1:2], 3, axis=-1)
    assert is_colorless(grey)
    assert not is_colorless(marked_render())
    assert reader().score(grey) == 0
    assert reader().score(np.full((HEIGHT, WIDTH, 3), (200, 30, 30), np.uint8)) == 0


def test_a_camera_that_sees_nothing_tells_nothing() -> None:
    empty = type(GAUSSIANS)({name: values[:0] for name, values in GAUSSIANS.parameters.items()})
    picture = photograph(GAUSSIANS, METHOD, beside(RIG))
    assert standard_score(picture, empty, METHOD, single_cameras(beside(RIG))[0], throws(SECRET)[:0]) == 0
