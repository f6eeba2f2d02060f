"""A surrogate learns what the leaked views can teach, and uses no others."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from stages.analysis.secrecy.linear_surrogate import linear_surrogate
from stages.analysis.secrecy.measuring import picture_readings
from stages.analysis.secrecy.readers import MESSAGE_DECODER, read, seeded_reader
from stages.analysis.secrecy.surrogate import SurrogateSettings, seen_views, train_surrogate
from stages.hiding.method import build_method
from stages.hiding.mixture import orthonormal_rows
from tests.stages.analysis.secrecy.observations import views

MIXTURE = orthonormal_rows(6, 8, np.random.default_rng(0))
PUBLIC = build_method(
    "gs_hider", {"feature_dim": 8, "layers": 2, "decoder_width": 16, "kernel_size": 3, "precision": "float32"}
)
NAMES = tuple(f"{number}.png" for number in range(43))


def mean(readings: list[torch.Tensor], observed: list, quantity: str = "psnr_covered") -> float:
    return float(np.mean([figures[quantity] for _, _, figures in picture_readings(readings, observed)]))


def test_it_learns_what_lies_in_the_features() -> None:
    seen, unseen = views(MIXTURE, 2, seed=1), views(MIXTURE, 2, seed=2)
    reader = seeded_reader(PUBLIC, 1, 0)
    losses = train_surrogate(reader, seen, SurrogateSettings(200, 12, 1e-2), 0, lambda: None)
    assert len(losses) == 200
    assert np.mean(losses[-20:]) < np.mean(losses[:20]) / 5
    with torch.no_grad():
        shown = [read(reader, each) for each in unseen]
    assert mean(shown, unseen) > mean(shown, unseen, "psnr_constant") + 5
    assert mean(linear_surrogate(seen, unseen), unseen) > 40  # the features are a linear map of the message


def test_squares_have_what_lies_around_them() -> None:
    """A reader that is exact on whole pictures stays exact on squares; zeros around a square would cause errors."""
    seen = views(MIXTURE, 1)
    reader = seeded_reader(PUBLIC, 1, 0)
    with torch.no_grad():
        exact = [replace(each, truths=read(reader, each)) for each in seen]
    losses = train_surrogate(reader, exact, SurrogateSettings(20, 8, 1e-9), 0, lambda: None)
    assert max(losses) < 1e-9


def test_every_view_that_leaked_is_learnt_from() -> None:
    reader = seeded_reader(PUBLIC, 1, 0)
    with torch.no_grad():
        off = [
            replace(each, truths=read(reader, each) + distance)
            for each, distance in zip(views(MIXTURE, 3), (1, 2, 3), strict=True)
        ]
    losses = train_surrogate(reader, off, SurrogateSettings(30, 8, 1e-9), 0, lambda: None)
    assert {round(loss) for loss in losses} == {1, 4, 9}


def test_steps_get_shorter_in_a_half_cosine() -> None:
    """Adam's steps are at most about as long as its rate."""
    reader = seeded_reader(PUBLIC, 1, 0)

    def weights() -> torch.Tensor:
        return torch.cat([each.detach().flatten() for each in reader.networks[MESSAGE_DECODER].parameters()])

    passed = [weights()]
    train_surrogate(reader, views(MIXTURE, 1), SurrogateSettings(20, 12, 1e-2), 0, lambda: passed.append(weights()))
    lengths = [float((after - before).abs().max()) for before, after in pairwise(passed)]
    assert lengths[0] == pytest.approx(1e-2, rel=1e-2)
    assert lengths[-1] < 0.02 * lengths[0]


def test_nothing_is_learnt_of_what_is_not_there() -> None:
    without = torch.cat([MIXTURE[:3], torch.zeros(3, 8)])
    seen, unseen = views(without, 2, seed=1), views(without, 2, seed=2)
    shown = linear_surrogate(seen, unseen)
    assert mean(shown, unseen) < mean(shown, unseen, "psnr_constant") + 0.5


def test_the_same_seed_learns_the_same_bits() -> None:
    seen = views(MIXTURE, 1)
    first, second = (
        train_surrogate(seeded_reader(PUBLIC, 1, 0), seen, SurrogateSettings(3, 10, 1e-2), 5, lambda: None)
        for _ in range(2)
    )
    assert first == second
    assert first != train_surrogate(seeded_reader(PUBLIC, 1, 0), seen, SurrogateSettings(3, 10, 1e-2), 6, lambda: None)


def test_no_views_teach_nothing() -> None:
    with pytest.raises(ValueError, match="nothing to train on"):
        train_surrogate(seeded_reader(PUBLIC, 1, 0), [], SurrogateSettings(1, 8, 1e-2), 0, lambda: None)


@given(st.floats(0, 1), st.floats(0, 1), st.integers(0, 100))
def test_a_smaller_share_is_part_of_a_larger_one(first: float, second: float, seed: int) -> None:
    small, large = (seen_views(NAMES, share, seed) for share in sorted((first, second)))
    assert set(small) <= set(large)
    assert len(set(large)) == len(large)
    assert (len(small) > 0) == (min(first, second) > 0)


def test_shares_of_the_fox() -> None:
    assert [len(seen_views(NAMES, share, 0)) for share in (0, 0.01, 0.05, 0.2, 1)] == [0, 1, 2, 9, 43]
    assert seen_views((), 0.5, 0) == ()
    assert set(seen_views(NAMES, 0.2, 0)) != set(seen_views(NAMES, 0.2, 1))
