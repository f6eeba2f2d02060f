"""The network runs both ways exactly, and a codec is the same after it was stored."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.hiding.watermark.codec import WatermarkCodec, new_codec
from stages.hiding.watermark.invertible import CouplingBlock, InvertibleNetwork
from stages.hiding.watermark.storage import read_codec, write_codec


def shaken(module: torch.nn.Module, scale: float = 0.1) -> torch.nn.Module:
    """Weights of any size in all layers: as they start, the last ones are zero."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for weight in module.parameters():
            weight.copy_(scale * torch.randn(weight.shape, generator=generator, dtype=weight.dtype))
    return module


def halves(channels: int, side: int = 6) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(2)
    cover, watermark = torch.randn(2, 2, channels, side, side, generator=generator, dtype=torch.float64)
    return cover, watermark


def test_what_goes_forward_comes_back() -> None:
    network = shaken(InvertibleNetwork(12, blocks=4, width=8).double(), 0.05)
    before = halves(12)
    after = network(*before)
    assert not torch.allclose(after[0], before[0], atol=0.1)
    for found, expected in zip(network.inverse(*after), before, strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)


def test_gradients_of_a_block_both_ways() -> None:
    block = shaken(CouplingBlock(3, width=4).double())
    cover, watermark = (half[:1, :, :3, :3].clone().requires_grad_() for half in halves(3))
    assert torch.autograd.gradcheck(block, (cover, watermark))
    assert torch.autograd.gradcheck(block.inverse, (cover, watermark))


def test_a_new_codec_hides_and_finds_nothing() -> None:
    codec = new_codec(2, 4, seed=0)
    images = torch.rand(2, 3, 8, 10, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(codec.watermark_encoder(images, images.flip(0)), images)
    torch.testing.assert_close(codec.watermark_decoder(images), torch.zeros_like(images))


def test_the_seed_decides_and_nothing_else_is_drawn() -> None:
    state = torch.random.get_rng_state()
    one, same, other = (new_codec(1, 4, seed).state_dict()["network.blocks.0.added.first.weight"] for seed in (0, 0, 1))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)
    assert torch.equal(torch.random.get_rng_state(), state)


def stored(folder: Path, codec: WatermarkCodec, **settings: object) -> Artifact:
    with create(folder, "codec") as writer:
        write_codec(writer, codec)
        writer.attributes.update(settings=dict(codec.settings) | settings)
    return load(folder)


def test_a_stored_codec_is_the_same(tmp_path: Path) -> None:
    codec = shaken(WatermarkCodec(2, 4))
    assert isinstance(codec, WatermarkCodec)
    images = torch.rand(1, 3, 8, 10, generator=torch.Generator().manual_seed(0))
    read = read_codec(stored(tmp_path / "codec", codec))
    assert torch.equal(read.watermark_decoder(images), codec.watermark_decoder(images))
    assert not any(weight.requires_grad for weight in read.parameters())


@pytest.mark.parametrize("settings", [{"blocks": 3}, {"width": 5}, {"blocks": "many"}])
def test_weights_that_do_not_fit_are_refused(tmp_path: Path, settings: dict[str, object]) -> None:
    with pytest.raises(UserError, match="do not fit"):
        read_codec(stored(tmp_path / "codec", WatermarkCodec(2, 4), **settings))
