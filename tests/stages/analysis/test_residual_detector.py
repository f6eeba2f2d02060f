"""The learned detector finds in other scenes what it was trained on, whatever the order of channels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from stages.analysis.residual_detector import (
    ResidualDetector,
    Views,
    _pairs,
    detector_scores,
    train_detector,
    views_of,
)
from stages.analysis.stored_views import StoredViews


def scene(seed: int, channels: int = 3, amplitude: float = 0.0) -> np.ndarray:
    """Six smooth pictures in colours of the scene's own; `amplitude` is added to every other pixel."""
    generator = np.random.default_rng(seed)
    rows, columns = np.mgrid[0:40, 0:48]
    slopes = generator.uniform(-2, 2, (6, channels, 2))
    smooth = 128 + slopes[..., :1, None] * (rows - 20) + slopes[..., 1:, None] * (columns - 24)
    noise = generator.normal(0, 0.5, smooth.shape)
    checks = amplitude * ((rows + columns) % 2)
    return (smooth + noise + checks).clip(0, 255).transpose(0, 2, 3, 1).astype(np.uint8)


def trained(seed: int = 0, iterations: int = 40) -> ResidualDetector:
    scenes = [(views_of(scene(number, amplitude=3)), views_of(scene(number))) for number in (1, 2)]
    return train_detector(scenes, seed, iterations, batch=4, size=32)


def test_it_finds_in_another_scene_what_it_was_shown() -> None:
    detector = trained()
    hidden, clean = (detector_scores(detector, views_of(scene(3, amplitude=a))) for a in (3, 0))
    assert min(hidden) > max(clean)


def test_it_learns_on_feature_maps_of_different_channels() -> None:
    def maps(seed: int, amplitude: float) -> Views:
        return views_of((scene(seed, 5, amplitude) / 255).astype(np.float16))

    detector = train_detector([(maps(1, 6), maps(1, 0))], 0, 40, batch=2, size=32)
    hidden, clean = (detector_scores(detector, views_of((scene(2, 7, a) / 255).astype(np.float16))) for a in (6, 0))
    assert np.mean(hidden) > np.mean(clean)


def test_the_order_of_channels_and_their_contrast_do_not_matter() -> None:
    torch.manual_seed(0)
    detector = ResidualDetector()
    values = scene(0, 4).astype(np.float16)
    expected = detector_scores(detector, views_of(values))
    assert detector_scores(detector, views_of(values[..., [2, 0, 3, 1]])) == pytest.approx(expected, rel=1e-4)
    assert detector_scores(detector, views_of(values / 4)) == pytest.approx(expected, rel=1e-2)


def test_smooth_content_is_no_hint() -> None:
    """The filters remove brightness."""
    torch.manual_seed(0)
    detector = ResidualDetector()
    values = scene(0).clip(0, 200).astype(np.uint8)
    expected = detector_scores(detector, views_of(values))
    assert detector_scores(detector, views_of(values + np.uint8(40))) == pytest.approx(expected, rel=1e-5)


def test_all_edges_are_alike_from_three_grey_levels_on() -> None:
    """Larger residuals are truncated, since they tell nothing; smaller ones tell how much was hidden."""
    torch.manual_seed(0)
    detector = ResidualDetector()

    def score(slope: int) -> float:
        ramp = np.broadcast_to(slope * np.arange(48, dtype=np.uint8)[:, None], (1, 40, 48, 3))
        return detector_scores(detector, views_of(ramp))[0]

    assert score(5) == score(4) == score(3)
    assert score(2) != pytest.approx(score(3), rel=1e-3)


def test_the_seed_decides_and_the_global_generators_do_not() -> None:
    views = views_of(scene(3))
    torch.manual_seed(1)
    first = detector_scores(trained(iterations=2), views)
    state = torch.random.get_rng_state()
    torch.manual_seed(2)
    assert detector_scores(trained(iterations=2), views) == first
    assert detector_scores(trained(seed=1, iterations=2), views) != first
    torch.manual_seed(1)
    assert torch.equal(torch.random.get_rng_state(), state)


def test_nothing_to_learn_from_is_said() -> None:
    with pytest.raises(ValueError, match="needs scenes"):
        train_detector([], 0)


def test_hidden_and_clean_are_seen_at_the_same_places() -> None:
    """Content is then no hint: two equal containers give equal crops."""
    views = views_of(scene(0))
    for hidden, clean in _pairs([(views, views)], 16, 20, np.random.default_rng(0)):
        assert hidden.shape == (3, 16, 16)
        assert torch.equal(hidden, clean)


def test_places_are_turned_over_in_every_way() -> None:
    views = views_of(scene(0)[:1])
    ways = [(), (1,), (2,), (1, 2)]
    whole = views.tensor(0)
    crops = [crop for crop, _ in _pairs([(views, views)], 64, 40, np.random.default_rng(0))]
    assert {way for way in ways for crop in crops if torch.equal(crop, whole.flip(way))} == {*ways}


class CountedViews(StoredViews):
    """Views that stay in memory, and count how often one is read."""

    def __init__(self, values: np.ndarray):
        self.values, self.shape, self.dtype = values, values.shape, values.dtype
        self.reads = 0

    def __getitem__(self, view: int) -> np.ndarray:
        self.reads += 1
        return self.values[view]

    def __iter__(self) -> Iterator[np.ndarray]:
        return iter(self.values)


def test_a_view_is_read_once_however_many_crops_are_cut_from_it() -> None:
    """Views on disk are large, and take longer to decode than a training step."""
    counted = [CountedViews(scene(number).astype(np.float16)) for number in range(4)]
    hidden, again, clean, clean_again = map(views_of, counted)
    train_detector([(hidden, clean), (again, clean_again)], 0, iterations=20, batch=4, size=24)
    assert [each.reads for each in counted] == [6, 6, 6, 6]
