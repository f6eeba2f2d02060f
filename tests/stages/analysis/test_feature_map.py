"""The picture of a feature map has its first three channels as colours."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stages.analysis.feature_map import feature_map_picture
from stages.hiding.coupled import FEATURES
from stages.hiding.rendering import Rendering
from stages.scene.gaussians import gaussians_at


@pytest.mark.parametrize("channels", [2, 3, 5])
def test_the_first_channels_are_shown_and_missing_ones_are_black(channels: int) -> None:
    blended = torch.rand(4, 6, channels, generator=torch.Generator().manual_seed(0))
    rendering = Rendering({}, blended, torch.ones(4, 6), torch.ones(1, dtype=torch.int), torch.zeros(1, 2))
    picture = feature_map_picture(gaussians_at(np.zeros((1, 3)), {FEATURES: torch.zeros(1, channels)}), rendering)
    assert picture is not None
    assert picture.shape == (4, 6, 3)
    shown = min(channels, 3)
    assert torch.equal(picture[..., :shown], blended[..., :shown])
    assert not picture[..., shown:].any()
    assert feature_map_picture(gaussians_at(np.zeros((1, 3)), {}), rendering) is None, "the pictures themselves"
