"""A seal leaves the cover as it is, gives back all that it moved to who has the key, and to nobody else."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.hiding.coupled import FEATURES
from stages.hiding.method import build_method
from stages.hiding.methods.homogeneous import Homogeneous
from stages.hiding.rendering import COVER
from stages.hiding.sealing import Seal, bands_for, can_be_sealed, rest_of, sealed, sources_of
from stages.hiding.stored_features import stored
from stages.scene.gaussians import Gaussians, gaussians_at
from stages.scene.moved_splats import chosen

KEY = bytes(range(32))
BANDS = 3


def homogeneous(feature_dim: int = 16, seed: int = 0) -> Homogeneous:
    usual = {"feature_dim": feature_dim, "layers": 2, "decoder_width": 8, "kernel_size": 1, "precision": "float32"}
    method = build_method("homogeneous", {**usual, "messages": ["message"]})
    assert isinstance(method, Homogeneous)
    method.initial_attributes({name: np.full((1, 3), 0.5) for name in (COVER, "message")}, np.random.default_rng(seed))
    return method


def some_gaussians(method: Homogeneous, count: int, spread: float, seed: int = 0) -> Gaussians:
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn(count, 3, generator=generator).numpy()
    features = spread * torch.randn(count, method.feature_dim, generator=generator)
    return gaussians_at(points, {FEATURES: features})


def centred(gaussians: Gaussians) -> torch.Tensor:
    return gaussians[FEATURES].double().sigmoid() - 0.5


@settings(deadline=None)
@given(
    count=st.integers(0, 40),
    spread=st.sampled_from([0.0, 0.1, 1.0]),
    seed=st.integers(0, 2**32 - 1),
    key=st.binary(min_size=32, max_size=32),
)
def test_the_cover_is_left_and_who_has_the_key_gets_back_everything(
    count: int, spread: float, seed: int, key: bytes
) -> None:
    method = homogeneous(seed=seed)
    gaussians = some_gaussians(method, count, spread, seed)
    closed = sealed(gaussians, method, key, BANDS)
    read = method.rows_read().double().T
    torch.testing.assert_close(centred(closed) @ read, centred(gaussians) @ read, rtol=0, atol=1e-5)
    back = Seal.of(closed, method, key, BANDS).opened(closed, torch.arange(count))
    torch.testing.assert_close(centred(back), centred(gaussians), rtol=0, atol=1e-5)
    assert torch.equal(back.means, gaussians.means)


def test_saturated_features_leave_the_cover_as_it_is() -> None:
    """But for what cannot be stored: at a corner of the cube there is no room for what another Gaussian holds."""
    method = homogeneous()
    gaussians = some_gaussians(method, 1000, 30.0)
    closed = sealed(gaussians, method, KEY, BANDS)
    read = method.rows_read().double().T
    torch.testing.assert_close(centred(closed) @ read, centred(gaussians) @ read, rtol=0, atol=1e-3)
    assert closed[FEATURES].isfinite().all()
    back = Seal.of(closed, method, KEY, BANDS).opened(closed, torch.arange(1000))
    torch.testing.assert_close(centred(back) @ read, centred(gaussians) @ read, rtol=0, atol=1e-3)


def test_who_has_another_key_gets_nothing() -> None:
    method = homogeneous()
    gaussians = some_gaussians(method, 500, 1.0)
    closed = sealed(gaussians, method, KEY, BANDS)
    for wrong in (closed, Seal.of(closed, method, bytes(32), BANDS).opened(closed, torch.arange(500))):
        together = torch.stack([centred(wrong).flatten(), unread(gaussians, method).flatten()])
        assert abs(torch.corrcoef(together)[0, 1]) < 0.1
    right = Seal.of(closed, method, KEY, BANDS).opened(closed, torch.arange(500))
    together = torch.stack([unread(right, method).flatten(), unread(gaussians, method).flatten()])
    assert torch.corrcoef(together)[0, 1] > 0.999


def unread(gaussians: Gaussians, method: Homogeneous) -> torch.Tensor:
    read, _ = torch.linalg.qr(method.rows_read().double().T)
    return centred(gaussians) - centred(gaussians) @ read @ read.T


def test_what_is_missing_takes_with_it_what_it_held() -> None:
    method = homogeneous()
    gaussians = some_gaussians(method, 300, 1.0)
    closed = sealed(gaussians, method, KEY, BANDS)
    kept = torch.randperm(300, generator=torch.Generator().manual_seed(0))[:200]
    found = chosen(closed, kept)
    rows = torch.full((300,), -1)
    rows[kept] = torch.arange(200)
    back = Seal.of(closed, method, KEY, BANDS).opened(found, rows)
    own = {tuple(mean.tolist()): feature for mean, feature in zip(gaussians.means, centred(gaussians), strict=True)}
    sources = sources_of(KEY, closed, BANDS)
    holder = {int(row): place for place, row in enumerate(sources)}
    assert len(back) == sum(holder[int(row)] in set(kept.tolist()) for row in kept)
    for mean, feature in zip(back.means, centred(back), strict=True):
        torch.testing.assert_close(feature, own[tuple(mean.tolist())], rtol=0, atol=1e-6)


def test_what_is_done_to_what_the_scene_decoder_reads_does_not_come_between() -> None:
    method = homogeneous()
    gaussians = some_gaussians(method, 300, 0.5)
    closed = sealed(gaussians, method, KEY, BANDS)
    read, _ = torch.linalg.qr(method.rows_read().double().T)
    noise = 0.02 * torch.randn(300, read.shape[1], generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    found = Gaussians(closed.parameters | {FEATURES: stored(0.5 + centred(closed) + noise @ read.T)})
    back = Seal.of(closed, method, KEY, BANDS).opened(found, torch.arange(300))
    torch.testing.assert_close(unread(back, method), unread(gaussians, method), rtol=0, atol=1e-5)


@pytest.mark.parametrize("bands", [1, 7, 16])
def test_rests_are_exchanged_among_those_about_as_opaque(bands: int) -> None:
    gaussians = some_gaussians(homogeneous(), 1000, 1.0)
    opacities = torch.randn(1000, generator=torch.Generator().manual_seed(0)).round(decimals=1)  # many are equal
    gaussians.parameters["logit_opacities"] = opacities
    sources = sources_of(KEY, gaussians, bands)
    assert sorted(sources.tolist()) == list(range(1000))
    rank = np.argsort(np.argsort(opacities.numpy(), kind="stable"))
    assert np.array_equal(rank * bands // 1000, rank[sources] * bands // 1000)
    assert (sources == torch.arange(1000)).float().mean() < 0.05
    assert not torch.equal(sources, sources_of(bytes(32), gaussians, bands))
    moved = Gaussians(gaussians.parameters | {"means": gaussians.means + 1})
    assert not torch.equal(sources, sources_of(KEY, moved, bands)), "another container of the same key"
    assert sources_of(KEY, some_gaussians(homogeneous(), 0, 1.0), bands).tolist() == []


def test_who_prunes_what_is_transparent_takes_nothing_of_what_is_opaque() -> None:
    method, count = homogeneous(), 1600
    gaussians = some_gaussians(method, count, 1.0)
    gaussians.parameters["logit_opacities"] = torch.randn(count, generator=torch.Generator().manual_seed(0))
    closed = sealed(gaussians, method, KEY, 16)
    kept = gaussians["logit_opacities"].argsort()[count // 4 :]
    rows = torch.full((count,), -1)
    rows[kept] = torch.arange(len(kept))
    assert len(Seal.of(closed, method, KEY, 16).opened(chosen(closed, kept), rows)) == len(kept)


def test_bands_are_not_small() -> None:
    assert [bands_for(count) for count in (0, 1, 999, 1000, 2500, 60_000, 10**7)] == [1, 1, 1, 1, 2, 4, 4]


def test_what_reads_everything_cannot_be_sealed() -> None:
    assert can_be_sealed(homogeneous())
    assert not can_be_sealed(homogeneous(feature_dim=8))
    assert not can_be_sealed(build_method("plain", {"sh_degree": 0}))


def test_a_feature_outside_of_the_cube_stays_finite() -> None:
    read, _ = torch.linalg.qr(torch.randn(16, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(0)))
    rest = rest_of(torch.full((1, 16), 0.5, dtype=torch.float64), read)
    assert rest.features().isfinite().all()
    assert 0 <= float(rest.shares) <= 1


@pytest.mark.parametrize("count", [0, 1])
def test_none_and_one(count: int) -> None:
    method = homogeneous()
    gaussians = some_gaussians(method, count, 1.0)
    closed = sealed(gaussians, method, KEY, BANDS)
    back = Seal.of(closed, method, KEY, BANDS).opened(closed, torch.arange(count))
    torch.testing.assert_close(centred(back), centred(gaussians), rtol=0, atol=1e-6)
