"""The gate sees a grain's colour apart from noise, edges and brightness, and a gated decoder survives the store."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from pipeline.artifact import create, load
from stages.hiding.watermark.codec import new_codec
from stages.hiding.watermark.colors import COLORS, GRAIN
from stages.hiding.watermark.gate import FILTERS, log_variances
from stages.hiding.watermark.storage import read_codec, write_codec


def noise(seed: int, *shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def preference(picture: torch.Tensor) -> float:
    """For the grain's colour over the colour across it: the last quarter of what the gate sees."""
    return float(log_variances(picture)[:, 2 * len(FILTERS) :].mean())


@pytest.mark.parametrize("factor", [0.5, 1.0, 1.5])
def test_grain_is_told_from_noise_at_any_brightness(factor: float) -> None:
    gray_edges = 0.1 * noise(0, 1, 1, 160, 120)
    coloured = 0.02 * noise(1, 1, 3, 160, 120)
    grain = 0.05 * COLORS[GRAIN][None, :, None, None] * noise(2, 1, 1, 160, 120)
    without = 0.5 + gray_edges + coloured
    assert abs(preference(factor * without)) < 0.1
    assert preference(factor * (without + grain)) > 1


def test_a_gated_decoder_shows_its_watermark_or_less(tmp_path: Path) -> None:
    watermark = torch.rand(3, 24, 32, generator=torch.Generator().manual_seed(0))
    images = torch.rand(2, 3, 24, 32, generator=torch.Generator().manual_seed(1))
    codec = new_codec(1, 4, seed=0)
    codec.close_gate(watermark, seed=3)
    assert {name.split(".")[0] for name, weight in codec.named_parameters() if weight.requires_grad} == {"gate"}
    shown = codec.watermark_decoder(images).detach()
    assert codec.gate is not None
    torch.testing.assert_close(shown, codec.gate(images).detach() * watermark)
    with create(tmp_path / "codec", "codec") as writer:
        write_codec(writer, codec.requires_grad_(False))
    assert torch.equal(read_codec(load(tmp_path / "codec")).watermark_decoder(images), shown)
