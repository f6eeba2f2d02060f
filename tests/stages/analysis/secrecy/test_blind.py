"""A blind reading finds what the scene decoder does not read, and nothing where nothing is hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from stages.analysis.secrecy.apart import THIN, feature_maps_of, surfaces_of
from stages.analysis.secrecy.blind import blind_readings, heeded_directions, ignored_directions, sensitivity, stretched
from stages.analysis.secrecy.conditions import CHANNELS, COMPONENTS, IGNORED, UNEXPLAINED
from stages.analysis.secrecy.measuring import picture_readings
from stages.hiding.coupled import FEATURES
from stages.hiding.methods.gs_hider import GSHider, build
from stages.hiding.mixture import orthonormal_rows
from stages.scene.cameras import single_cameras
from stages.scene.gaussians import Gaussians, gaussians_at
from tests.stages.analysis.attacks.containers import cameras, target_and_owner
from tests.stages.analysis.secrecy.observations import views

M = 8
NO_GAUSSIANS = Gaussians({})
"""Of methods whose Gaussians say nothing of their own, none is looked at."""


@pytest.fixture
def mixture() -> torch.Tensor:
    return orthonormal_rows(6, M, np.random.default_rng(4))


@pytest.fixture
def public(mixture: torch.Tensor) -> GSHider:
    """A scene decoder that shows the cover's three directions and reads nothing else."""
    method = build({"feature_dim": M, "layers": 2, "decoder_width": 4, "kernel_size": 3, "precision": "float32"})
    with torch.no_grad():
        for weights in method.scene_decoder.parameters():
            weights.zero_()
    method.scene_decoder.pass_through(mixture[:3])
    return method


def correlations(readings: list[torch.Tensor], observed: list) -> float:
    found = picture_readings([each[None] for each in stretched(readings)], observed)
    return float(np.mean([figures["correlation"] for _, _, figures in found]))


def test_both_ways_past_the_cover_find_the_message(public: GSHider, mixture: torch.Tensor) -> None:
    observed = views(mixture)
    found = blind_readings(NO_GAUSSIANS, public, observed, seed=0)
    assert set(found) == {CHANNELS, COMPONENTS, UNEXPLAINED, IGNORED}
    assert correlations(found[IGNORED], observed) > 0.95
    assert correlations(found[UNEXPLAINED], observed) > 0.9
    assert correlations(found[CHANNELS], observed) < 0.9


def test_without_a_message_there_is_nothing_to_find(public: GSHider, mixture: torch.Tensor) -> None:
    hiding, clean = views(mixture), views(torch.cat([mixture[:3], torch.zeros(3, M)]))
    found = blind_readings(NO_GAUSSIANS, public, clean, seed=0)
    shown = correlations(blind_readings(NO_GAUSSIANS, public, hiding, 0)[IGNORED], hiding)
    assert correlations(found[IGNORED], clean) < shown - 0.3


def test_the_scene_decoder_is_sensitive_to_what_it_shows(public: GSHider, mixture: torch.Tensor) -> None:
    heeded = sensitivity(public, views(mixture), seed=0).float()
    along = torch.einsum("km,mn,kn->k", mixture, heeded, mixture)
    assert (along[:3] > 0.5).all()
    assert (along[3:] < 1e-6).all()
    assert torch.equal(sensitivity(public, views(mixture), seed=0).float(), heeded)
    assert not torch.equal(sensitivity(public, views(mixture), seed=1).float(), heeded)


def test_ignored_directions_weigh_variance_against_sensitivity() -> None:
    generator = torch.Generator().manual_seed(0)
    spread = torch.tensor([1.0, 3.0, 0.1, 0.5])
    maps = [torch.randn(30, 30, 4, generator=generator) * spread]
    directions = ignored_directions(maps, torch.diag(torch.tensor([1e-2, 10.0, 1e-2, 1e-2], dtype=torch.float64)))
    first = directions[:, 0].abs() / directions[:, 0].abs().max()
    assert first.argmax() == 0


def test_heeded_directions_show_nothing_of_what_is_not_heeded() -> None:
    generator = torch.Generator().manual_seed(0)
    maps = [torch.randn(30, 30, 4, generator=generator) * torch.tensor([1.0, 9.0, 0.5, 1.0])]
    directions = heeded_directions(maps, torch.diag(torch.tensor([4.0, 0.0, 4.0, 0.1], dtype=torch.float64)))
    assert directions[1].abs().max() < 1e-6
    assert directions[:, 0].abs().argmax() == 0


def test_features_of_some_gaussians_are_told_from_the_grey_between_them() -> None:
    """All features are 3/4, and so 1/4 more than nothing, whatever a pixel's opacity; empty pixels show 0."""
    target, _ = target_and_owner("homogeneous")
    raw = torch.full_like(target.gaussians[FEATURES], 3.0).log()
    gaussians = target.with_parameters({FEATURES: raw}).gaussians
    seen = replace(views(torch.eye(6), 1)[0], camera=single_cameras(cameras())[0])
    [found] = feature_maps_of(gaussians, target.method, [seen])
    [surfaces] = surfaces_of(gaussians, [seen])
    filled = surfaces[..., 2:]
    assert float(filled.min()) < 0.1 < 0.9 < float(filled.max())
    torch.testing.assert_close(found, (0.25 * filled / (filled + THIN)).expand_as(found), rtol=0, atol=1e-4)


def test_surfaces_are_depths_inverse_depths_and_opacity() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (40, 3))
    points[:, 2] = 1.0
    [seen] = views(torch.eye(6), 1)
    back = torch.eye(4)
    back[2, 3] = 3.0
    seen = replace(seen, camera=replace(seen.camera, world_to_camera=back))
    [shown] = surfaces_of(gaussians_at(points, {}), [seen])
    share = shown[..., 2] / (shown[..., 2] + THIN)
    assert float(share.max()) > 0.5
    torch.testing.assert_close(shown[..., 0], 4 * share, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(shown[..., 1], share / 4, rtol=1e-4, atol=1e-5)


def test_stretching_uses_all_grey_values_and_leaves_constants_grey() -> None:
    slope = torch.linspace(-3, 7, 200).reshape(10, 20)
    [shown] = stretched([torch.stack([slope, torch.full_like(slope, 9.0)], dim=-1)])
    assert float(shown[..., 0].min()) == 0
    assert float(shown[..., 0].max()) == 1
    assert torch.allclose(shown[..., 1], torch.tensor(0.5))


def test_stretching_is_the_same_for_all_views_and_ignores_strays() -> None:
    slope = torch.linspace(-3, 7, 400).reshape(20, 20, 1)
    dark, bright = stretched([slope, slope + 10])
    assert float(dark.max()) == pytest.approx(0.5, abs=0.01)
    assert float(bright.min()) == pytest.approx(0.5, abs=0.01)
    strayed = slope.clone()
    strayed[0, 0], strayed[-1, -1] = -1e6, 1e6
    torch.testing.assert_close(stretched([strayed]), stretched([slope]), rtol=0, atol=0.01)
