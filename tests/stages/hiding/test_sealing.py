"""A seal leaves the cover unchanged; those who have the key get back all that it encrypted, and nobody else does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from stages.hiding import expected
from stages.hiding.coupled import FEATURES
from stages.hiding.expected import Expected
from stages.hiding.keystream import MOST_DIMENSIONS
from stages.hiding.method import build_method
from stages.hiding.methods.homogeneous import Homogeneous
from stages.hiding.rendering import COVER
from stages.hiding.sealing import Seal, can_be_sealed
from stages.hiding.stored_features import FARTHEST, stored
from stages.scene.gaussians import Gaussians, gaussians_at

KEY = bytes(range(32))


def homogeneous(feature_dim: int = 16, seed: int = 0, messages: tuple[str, ...] = ("message",)) -> Homogeneous:
    usual = {"feature_dim": feature_dim, "layers": 2, "decoder_width": 8, "kernel_size": 1, "precision": "float32"}
    method = build_method("homogeneous", {**usual, "messages": messages})
    assert isinstance(method, Homogeneous)
    method.initial_attributes({name: np.full((1, 3), 0.5) for name in (COVER, *messages)}, np.random.default_rng(seed))
    return method


def some_gaussians(method: Homogeneous, count: int, spread: float, seed: int = 0) -> Gaussians:
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn(count, 3, generator=generator).numpy()
    features = spread * torch.randn(count, method.feature_dim, generator=generator)
    return gaussians_at(points, {FEATURES: features})


def sealed(
    gaussians: Gaussians, method: Homogeneous, key: bytes
) -> tuple[Gaussians, Callable[[Gaussians, torch.Tensor], Gaussians]]:
    """The published Gaussians, and the function with which their owner opens what is found of them."""
    made = Seal.made(gaussians, method, key)
    return made.published, Seal.of(made.published, method, made.key, made.expected).opened


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
    closed, opened = sealed(gaussians, method, key)
    read = method.rows_read().double().T
    torch.testing.assert_close(centred(closed) @ read, centred(gaussians) @ read, rtol=0, atol=1e-5)
    back = opened(closed, torch.arange(count))
    torch.testing.assert_close(centred(back), centred(gaussians), rtol=0, atol=1e-5)
    assert torch.equal(back.means, gaussians.means)


def test_saturated_features_leave_the_cover_as_it_is() -> None:
    """Only what exceeds the range that can be stored is lost."""
    method = homogeneous()
    gaussians = some_gaussians(method, 1000, 30.0)
    closed, opened = sealed(gaussians, method, KEY)
    read = method.rows_read().double().T
    torch.testing.assert_close(centred(closed) @ read, centred(gaussians) @ read, rtol=0, atol=1e-3)
    assert closed[FEATURES].isfinite().all()
    back = opened(closed, torch.arange(1000))
    torch.testing.assert_close(centred(back) @ read, centred(gaussians) @ read, rtol=0, atol=1e-3)


def test_features_beyond_what_can_be_stored_come_back_as_they_can_be() -> None:
    """Sealing computes cover shares from the stored features, since opening has no others."""
    method = homogeneous()
    gaussians = some_gaussians(method, 1000, 8.0)
    closed, opened = sealed(gaussians, method, KEY)
    back = opened(closed, torch.arange(1000))
    torch.testing.assert_close(centred(back), centred(gaussians).clamp(-FARTHEST, FARTHEST), rtol=0, atol=1e-5)


@pytest.mark.parametrize("messages", [("message",), ("one", "another")])
def test_gaussians_as_they_begin_are_given_back(messages: tuple[str, ...]) -> None:
    """Many have the same cover share, so a tiny change of a share must not change what is opened."""
    method, generator = homogeneous(messages=messages), np.random.default_rng(0)
    owners = generator.integers(1 + len(messages), size=4000)
    colors = {
        name: np.where((owners == number)[:, None], generator.uniform(size=(4000, 3)), 0.5)
        for number, name in enumerate((COVER, *messages))
    }
    features = method.initial_attributes(colors, np.random.default_rng(0))
    gaussians = gaussians_at(generator.normal(size=(4000, 3)), features)
    closed, opened = sealed(gaussians, method, KEY)
    back = opened(closed, torch.arange(4000))
    torch.testing.assert_close(centred(back), centred(gaussians), rtol=0, atol=5e-5)


def test_few_stay_in_the_clear_even_where_features_are_saturated() -> None:
    method = homogeneous()
    counts = [Seal.made(some_gaussians(method, 1000, spread), method, KEY).in_the_clear for spread in (1, 3, 8)]
    assert counts[:2] == [0, 0]
    assert counts[2] < 20


def test_what_is_as_expected_noise_cannot_change_much() -> None:
    method = homogeneous()
    gaussians = some_gaussians(method, 1000, 0.3)
    around = centred(gaussians) - unread(gaussians, method)
    same = around + unread(gaussians, method)[:1] + 0.02 * unread(gaussians, method)
    gaussians = gaussians.with_parameters({FEATURES: stored(0.5 + same)})
    closed, opened = sealed(gaussians, method, KEY)
    noise = 0.02 * torch.randn(1000, 16, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    found = closed.with_parameters({FEATURES: stored(0.5 + centred(closed) + noise)})
    back = opened(found, torch.arange(1000))
    assert (unread(back, method) - unread(gaussians, method)).norm(dim=1).max() < 0.05


def test_who_has_another_key_gets_nothing() -> None:
    method = homogeneous()
    gaussians = some_gaussians(method, 500, 1.0)
    made = Seal.made(gaussians, method, KEY)
    for wrong in (made.published, replace(made, key=bytes(32)).opened(made.published, torch.arange(500))):
        together = torch.stack([unread(wrong, method).flatten(), unread(gaussians, method).flatten()])
        assert abs(torch.corrcoef(together)[0, 1]) < 0.1
    right = made.opened(made.published, torch.arange(500))
    together = torch.stack([unread(right, method).flatten(), unread(gaussians, method).flatten()])
    assert torch.corrcoef(together)[0, 1] > 0.999


def unread(gaussians: Gaussians, method: Homogeneous) -> torch.Tensor:
    read, _ = torch.linalg.qr(method.rows_read().double().T)
    return centred(gaussians) - centred(gaussians) @ read @ read.T


def test_what_is_missing_takes_nothing_from_others() -> None:
    method = homogeneous()
    gaussians = some_gaussians(method, 300, 1.0)
    closed, opened = sealed(gaussians, method, KEY)
    kept = torch.randperm(300, generator=torch.Generator().manual_seed(0))[:200]
    rows = torch.full((300,), -1)
    rows[kept] = torch.arange(200)
    moved = closed.with_parameters({"means": closed.means + 1})
    back = opened(moved.select(kept), rows)
    in_order = kept.sort().values
    assert torch.equal(back.means, moved.means[in_order]), "only features are changed"
    torch.testing.assert_close(centred(back), centred(gaussians)[in_order], rtol=0, atol=1e-5)


@pytest.mark.parametrize("count", [0, 300])
def test_where_none_is_found_none_comes_back(count: int) -> None:
    method = homogeneous()
    closed, opened = sealed(some_gaussians(method, 300, 1.0), method, KEY)
    found = closed.select(torch.arange(count))
    assert len(opened(found, torch.full((300,), -1))) == 0


def test_what_is_done_to_what_the_scene_decoder_reads_does_not_come_between() -> None:
    method = homogeneous()
    gaussians = some_gaussians(method, 300, 0.5)
    closed, opened = sealed(gaussians, method, KEY)
    read, _ = torch.linalg.qr(method.rows_read().double().T)
    noise = 0.02 * torch.randn(300, read.shape[1], generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    changed = centred(closed) + noise @ read.T
    back = opened(closed.with_parameters({FEATURES: stored(0.5 + changed)}), torch.arange(300))
    there = changed.abs().amax(dim=1) < FARTHEST  # what leaves the cube cannot be stored
    assert there.sum() > 200
    torch.testing.assert_close(unread(back, method)[there], unread(gaussians, method)[there], rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "changed", [FEATURES, "means", "logit_opacities", "quats", "key", "scene_decoder", "message_decoder"]
)
def test_no_pad_is_used_twice(changed: str) -> None:
    method = homogeneous()
    gaussians = some_gaussians(method, 5, 1.0)
    others = {name: values + 1 for name, values in gaussians.parameters.items() if name == changed}
    other_method = homogeneous()
    if network := other_method.networks.get(changed):
        network.directions.data += 1
    other_key = bytes(32) if changed == "key" else KEY
    other = Seal.made(gaussians.with_parameters(others), other_method, other_key)
    assert Seal.made(gaussians, method, KEY).key == Seal.made(gaussians, method, KEY).key != other.key


def test_no_pad_is_used_for_another_expectation(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is encrypted is the difference from what is expected, and a later version may expect something else."""
    method = homogeneous()
    gaussians = some_gaussians(method, 600, 1.0)
    before = Seal.made(gaussians, method, KEY)
    monkeypatch.setattr(expected, "KNOTS", 1)
    after = Seal.made(gaussians, method, KEY)
    assert before.expected.facts() != after.expected.facts()
    assert before.key != after.key


def test_features_of_more_channels_than_can_be_encrypted_are_not_sealed() -> None:
    """The keystream grows with the square of the channels: whoever opens such a container would run out of memory."""
    assert can_be_sealed(homogeneous(feature_dim=8 + MOST_DIMENSIONS))
    assert not can_be_sealed(homogeneous(feature_dim=9 + MOST_DIMENSIONS))


def test_a_corner_of_the_cube_stays_as_it_is() -> None:
    method = homogeneous()
    read, _ = torch.linalg.qr(method.rows_read().double().T)
    gaussians = some_gaussians(method, 1, 1.0)
    cornered = gaussians.with_parameters({FEATURES: stored(0.5 + 9 * (read @ read.T).sum(dim=1)[None].sign())})
    assert Seal.made(cornered, method, KEY).in_the_clear == 1
    closed, opened = sealed(cornered, method, KEY)
    back = opened(closed, torch.arange(1))
    torch.testing.assert_close(centred(back), centred(cornered), rtol=0, atol=1e-6)


def test_what_reads_everything_cannot_be_sealed() -> None:
    assert can_be_sealed(homogeneous())
    assert not can_be_sealed(homogeneous(feature_dim=8))
    assert not can_be_sealed(build_method("plain", {"sh_degree": 0}))


def test_what_is_read_twice_leaves_room_for_a_seal() -> None:
    method = homogeneous(feature_dim=8)
    readings = method.scene_decoder.readings.detach().clone()
    readings[0, -1] = readings[0, 0] + 1e-6
    method.scene_decoder.look_along(method.scene_decoder.directions, readings)
    assert can_be_sealed(method)


def test_what_the_message_decoder_hardly_reads_is_not_expected_far_away() -> None:
    """One of its readings is that of the scene decoder, but for next to nothing."""
    method, axes = homogeneous(), torch.eye(16)
    readings = axes[9:].clone()
    readings[0] = axes[1] + 1e-9 * axes[9]
    method.scene_decoder.look_along(axes[:1], axes[None, 1:8])
    method.message_decoder.look_along(axes[8:9], readings[None])
    gaussians = some_gaussians(method, 300, 1.0)
    made = Seal.made(gaussians, method, KEY)
    assert made.expected.farthest.max() < 10
    back = made.opened(made.published, torch.arange(300))
    torch.testing.assert_close(centred(back), centred(gaussians), rtol=0, atol=1e-5)


@pytest.mark.parametrize("count", [0, 1])
def test_none_and_one(count: int) -> None:
    method = homogeneous()
    gaussians = some_gaussians(method, count, 1.0)
    closed, opened = sealed(gaussians, method, KEY)
    back = opened(closed, torch.arange(count))
    torch.testing.assert_close(centred(back), centred(gaussians), rtol=0, atol=1e-6)


def test_what_was_published_earlier_is_opened_by_later_versions() -> None:
    """The last Gaussian is beyond the first block of the keystream."""
    method, axes = homogeneous(), torch.eye(16)
    method.scene_decoder.look_along(axes[:1], axes[None, 1:8])
    method.message_decoder.look_along(axes[8:9], axes[None, 9:])
    published = gaussians_at(np.zeros((5000, 3)), {FEATURES: torch.linspace(-1, 1, 16).expand(5000, -1)})
    readings = np.array([[0.1] * 8, [-0.1] * 8])
    expected = Expected(np.array([0.0, 1.0]), readings, np.array([0.1, 0.1]), np.array([1.0, 1.0]))
    seal = Seal.of(published, method, KEY, expected)
    opened = seal.opened(published, torch.arange(5000))
    of_the_first = [-0.07942, 0.07386, 0.16226, 0.21777, 0.21121, 0.35645, 0.34704, -0.19442]
    of_the_last = [0.04556, 0.05752, 0.06876, 0.12421, -0.02974, 0.07772, 0.01812, 0.01257]
    expected_features = torch.tensor([of_the_first, of_the_last]).double()
    torch.testing.assert_close(centred(opened)[[0, -1], 8:], expected_features, rtol=0, atol=2e-5)
    assert seal.signs() == 64 * b"\x55", "eight signs of each of 64 Gaussians, which a secret holds"
    rising = torch.linspace(-1, 1, 5000)[:, None] * torch.ones(16)
    of_all = Seal.of(gaussians_at(np.zeros((5000, 3)), {FEATURES: rising}), method, KEY, expected).signs()
    assert of_all == 32 * b"\xff" + 32 * b"\x00", "evenly spread over all Gaussians"
