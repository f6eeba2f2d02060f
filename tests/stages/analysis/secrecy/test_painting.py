"""Leaked views are painted onto Gaussians; some belong to the message, others are fog in front of it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stages.analysis.secrecy.observing import Observed
from stages.analysis.secrecy.painting import painted_surrogate
from stages.hiding.rendering import COVER, Rendering, splat
from stages.imaging.psnr import psnr
from stages.scene.cameras import single_cameras
from stages.scene.gaussians import Gaussians, gaussians_at
from tests.stages.analysis.attacks.containers import cameras

MESSAGES, FOG = 300, 100
DIVIDED = 0.03


class Told:
    """Only the last Gaussian belongs to the cover; the others have no share of it."""

    def cover_shares(self, gaussians: Gaussians) -> torch.Tensor:
        return (torch.arange(len(gaussians)) == len(gaussians) - 1).float()


def container() -> tuple[Gaussians, torch.Tensor, torch.Tensor]:
    """Gaussians, their colours in the message, and their shares of it: fog has none."""
    generator = np.random.default_rng(0)
    count = MESSAGES + FOG + 1
    gaussians = gaussians_at(generator.uniform(-1, 1, (count, 3)), {})
    gaussians.parameters["logit_opacities"] += 1.5
    share = torch.ones(count, 1)
    share[MESSAGES:] = 0
    return gaussians, torch.from_numpy(generator.uniform(0, 1, (count, 3))).float(), share


def observed() -> list[Observed]:
    gaussians, colors, share = container()
    views = []
    for number, camera in enumerate(single_cameras(cameras())):
        rendering = splat(gaussians, torch.cat([share * colors, share], dim=1), camera)
        truth = rendering.feature_map[..., :3] / (rendering.feature_map[..., 3:] + DIVIDED)
        shown = Rendering(
            {COVER: truth},
            rendering.feature_map,
            rendering.alphas,
            torch.empty(0, dtype=torch.int32),
            torch.empty(0, 2),
        )
        views.append(Observed(f"{number}.png", camera, shown, truth[None], torch.ones(1, *truth.shape[:2])))
    return views


def test_other_views_are_painted_as_the_owner_would_see_them() -> None:
    """Colours are divided by learnt shares; merely blended over black, the fog would darken the message."""
    gaussians, _, _ = container()
    views = observed()
    seen, hidden = views[:-1], views[-1:]
    [painted] = painted_surrogate(gaussians, Told(), seen, hidden, 0, lambda: None)
    assert float(psnr(painted[0].clamp(0, 1), hidden[0].truths[0].clamp(0, 1))) > 24


def test_it_paints_the_same_of_the_same_seed_and_nothing_without_a_view() -> None:
    gaussians, _, _ = container()
    views = observed()
    (first,), (again,), (other,) = (
        painted_surrogate(gaussians, Told(), views[:2], views[2:3], seed, lambda: None) for seed in (3, 3, 4)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    with pytest.raises(ValueError, match="without a view"):
        painted_surrogate(gaussians, Told(), [], views, 0, lambda: None)
