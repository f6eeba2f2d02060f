"""Homogeneous features: Gaussians that belong to one picture leave the others unchanged, wherever they are."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stages.hiding.coupled import FEATURES
from stages.hiding.methods import homogeneous
from stages.hiding.methods.homogeneous import (
    BEYOND_WEIGHT,
    READINGS,
    SHARED_WEIGHT,
    SMALLEST_SHARE,
    VIEW_CHANNELS,
    Homogeneous,
    HomogeneousDecoder,
)
from stages.hiding.mixture import orthonormal_rows
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.hiding.stored_features import stored
from stages.scene.cameras import Cameras, single_cameras
from stages.scene.gaussians import Gaussians, gaussians_at

MESSAGE = "message"
SIZE = 24
RED, BLUE = np.array([0.8, 0.3, 0.2]), np.array([0.1, 0.3, 0.9])


def wall(depth: float) -> np.ndarray:
    across = np.linspace(-1, 1, 12) * depth
    return np.stack([*map(np.ravel, np.meshgrid(across, across)), np.full(144, depth)], axis=1)


def camera() -> Cameras:
    intrinsics = np.array([[[SIZE, 0, SIZE / 2], [0, SIZE, SIZE / 2], [0, 0, 1]]], dtype=float)
    return Cameras(("a",), np.eye(4)[None], intrinsics, SIZE, SIZE)


def method(feature_dim: int = 16, layers: int = 2, precision: str = "float32") -> Homogeneous:
    torch.manual_seed(0)
    return Homogeneous(feature_dim, layers=layers, decoder_width=8, precision=precision, messages=[MESSAGE])


def scene(hider: Homogeneous, opacity: float, key: int = 0) -> Gaussians:
    """A red wall of the cover, and in front of it a blue wall of the message."""
    grey = np.full((144, 3), 0.5)
    colors = {COVER: np.concatenate([grey + RED - 0.5, grey]), MESSAGE: np.concatenate([grey, grey + BLUE - 0.5])}
    points = np.concatenate([wall(4.0), wall(2.0)])
    gaussians = gaussians_at(points, hider.initial_attributes(colors, np.random.default_rng(key)))
    gaussians.parameters["logit_opacities"] = torch.logit(torch.full((288,), opacity))
    return gaussians


@pytest.mark.parametrize("opacity", [0.03, 0.1])
def test_each_picture_is_seen_through_the_other(opacity: float) -> None:
    """Averaged over keys: with some, a feature exceeds its range and is clamped."""
    hider, middle = method(), slice(8, 16)
    shown: dict[str, list[np.ndarray]] = {COVER: [], MESSAGE: []}
    for key in range(8):
        (view,) = photographs(scene(hider, opacity, key), hider, camera())
        for name, colors in shown.items():
            colors.append(view.pictures[name][middle, middle].mean(dim=(0, 1)).numpy())
    np.testing.assert_allclose(np.mean(shown[COVER], axis=0), RED, atol=0.12)
    np.testing.assert_allclose(np.mean(shown[MESSAGE], axis=0), BLUE, atol=0.12)


def test_dividing_undoes_any_veil() -> None:
    """Σ w f / Σ w e: a veil of Gaussians without a share scales both sums alike."""
    decoder = HomogeneousDecoder(8, 1, layers=2, width=8)
    mixture = orthonormal_rows(1 + READINGS, 8, np.random.default_rng(1))
    decoder.start(mixture[:1], mixture[None, 1:])
    color = torch.tensor([0.3, -0.2, 0.1])
    own, veil = 0.5 + 0.5 * mixture[0] + color @ mixture[1:4], 0.5 - 0.5 * mixture[0]
    for veiled in (0.0, 0.4, 0.9):
        feature_map = (veiled * veil + (1 - veiled) * own)[None, None]
        with torch.no_grad():
            half_alphas = torch.full((1, 1, 1), 0.5)
            divided = torch.cat(decoder.divided(feature_map - half_alphas, half_alphas), dim=-1)[0, 0]
        share = 1 - veiled
        torch.testing.assert_close(divided[-1], torch.tensor(share))
        torch.testing.assert_close(divided[:3] * (share + SMALLEST_SHARE) / share, color)


def test_nothing_at_all_gives_finite_pictures_and_gradients() -> None:
    hider = method()
    empty = scene(hider, 0.1)
    empty.parameters["means"] = empty.means - torch.tensor([0.0, 0.0, 100.0])
    empty.parameters["raw_features"].requires_grad_()
    rendering = hider.render(empty, single_cameras(camera())[0])
    sum(picture.sum() for picture in rendering.pictures.values()).backward()
    assert all(torch.isfinite(picture).all() for picture in rendering.pictures.values())
    assert all(torch.isfinite(weight.grad).all() for weight in hider.scene_decoder.parameters())


def test_more_messages_than_channels_have_room_for() -> None:
    names = [f"message {number}" for number in range(5)]
    torch.manual_seed(0)
    hider = Homogeneous(8, layers=2, decoder_width=16, precision="float32", messages=names)
    colors = {name: np.full((3, 3), 0.4) for name in (COVER, *names)}
    attributes = hider.initial_attributes(colors, np.random.default_rng(0))
    assert attributes["raw_features"].shape == (3, 8)
    assert torch.isfinite(attributes["raw_features"]).all()


def test_bfloat16_rounds_pictures_a_little_and_no_more() -> None:
    (view,) = single_cameras(camera())
    pictures = []
    for precision in ("bfloat16", "float32"):
        hider = method(layers=4, precision=precision)
        with torch.no_grad():
            pictures.append(hider.render(scene(hider, 0.5), view).pictures[MESSAGE])
    assert not torch.equal(*pictures)
    torch.testing.assert_close(*pictures, rtol=0, atol=0.02)


def penalised(hider: Homogeneous, features: torch.Tensor) -> torch.Tensor:
    gaussians = gaussians_at(np.zeros((len(features), 3)), {"raw_features": features.clamp(0.01, 0.99).logit()})
    gaussians.parameters["raw_features"].requires_grad_()
    penalty = hider.penalty(gaussians)
    assert penalty is not None
    penalty.backward()
    gradient = gaussians["raw_features"].grad
    assert gradient is not None
    assert torch.isfinite(gradient).all()
    changed = [name for name, weight in hider.scene_decoder.named_parameters() if weight.grad is not None]
    assert changed == ["readings"]
    return penalty.detach()


@pytest.mark.parametrize("in_place", [True, False], ids=["the CPU's kernels", "torch, as on GPUs"])
def test_the_penalty_is_on_what_serves_two_pictures_and_on_what_is_held_beyond_a_share(
    monkeypatch: pytest.MonkeyPatch, in_place: bool
) -> None:
    monkeypatch.setattr(homogeneous, "works_in_place", lambda device: in_place)
    hider = method()
    scene(hider, 0.5)  # sets the decoders' directions
    own, other = hider.scene_decoder.directions[0].detach(), hider.message_decoder.directions[0].detach()
    reading = hider.scene_decoder.readings[0, 0].detach()
    one, both, held = 0.25 * (own - other), 0.25 * (own + other), 0.3 * reading
    fair, shared, held_by_the_owner, held_by_another = (
        float(penalised(hider, 0.5 + features[None])) for features in (one, both, one + held, held - one)
    )
    assert shared - fair == pytest.approx(SHARED_WEIGHT * (0.75**2 - 0.75 * 0.25), rel=1e-3)
    assert held_by_the_owner == pytest.approx(fair, rel=1e-3)
    assert held_by_another - fair == pytest.approx(BEYOND_WEIGHT * (0.3 - 0.125) / READINGS, rel=1e-3)


def test_without_a_message_there_is_no_penalty() -> None:
    hider = Homogeneous(8, layers=2, decoder_width=8, precision="float32")
    assert hider.penalty(gaussians_at(np.zeros((1, 3)), {"raw_features": torch.zeros(1, 8)})) is None


def test_shares_of_the_cover_are_large_where_only_the_cover_has_a_colour() -> None:
    """A point without any colour belongs to both pictures by half."""
    hider = method()
    colors = {COVER: np.array([[0.6, 0.5, 0.5], [0.5] * 3, [0.5] * 3]), MESSAGE: np.full((3, 3), 0.5)}
    colors[MESSAGE][1, 2] = 0.4
    features = hider.initial_attributes(colors, np.random.default_rng(0))
    shares = hider.cover_shares(gaussians_at(np.zeros((3, 3)), features))
    torch.testing.assert_close(shares.detach(), torch.tensor([0.98, 0.02, 0.5]), rtol=0, atol=0.01)


def test_a_picture_changes_only_with_what_its_decoder_is_said_to_read() -> None:
    hider = method()
    gaussians, (view,) = scene(hider, 0.5), single_cameras(camera())
    noise = 0.05 * torch.randn(len(gaussians), 16, generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    @torch.no_grad()
    def pictures(features: torch.Tensor) -> list[torch.Tensor]:
        shown = hider.render(gaussians.with_parameters({FEATURES: stored(features)}), view).pictures
        return [shown[name] for name in (COVER, MESSAGE)]

    features = 0.25 + 0.5 * gaussians[FEATURES].double().sigmoid()  # so that nothing exceeds what can be stored
    before = pictures(features)
    for number, rows in enumerate((hider.rows_read(), hider.rows_of_messages())):
        read, _ = torch.linalg.qr(rows.detach().double().T)
        after = pictures(features + noise - noise @ read @ read.T)
        torch.testing.assert_close(after[number], before[number], rtol=0, atol=1e-5)
        assert (after[1 - number] - before[1 - number]).abs().max() > 0.01


def test_decoders_see_the_viewing_direction() -> None:
    hider, (view,) = method(), single_cameras(camera())
    gaussians = scene(hider, 0.5)
    with torch.no_grad():
        before = hider.render(gaussians, view).pictures[COVER]
        hider.scene_decoder.convolutions.convolutions[0].weight[:, -VIEW_CHANNELS:] += 0.5
        after = hider.render(gaussians, view).pictures[COVER]
    assert (after - before).abs().max() > 0.01
