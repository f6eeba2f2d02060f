"""The network is exactly invertible, and a codec is the same after a round trip through the store."""

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
    """Draw all weights at random: the last layers start at zero."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for weight in module.parameters():
            weight.copy_(scale * torch.randn(weight.shape, generator=generator, dtype=weight.dtype))
    return module


def halves(channels: int, side: int = 6) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(2)
    cover, watermark = torch.randn(2, 2, channels, side, side, generator=generator, dtype=torch.float64)
    return cover, watermark


@pytest.mark.parametrize("whole", [False, True])
def test_what_goes_forward_comes_back(whole: bool) -> None:
    network = InvertibleNetwork(12, blocks=4, width=8)
    if whole:
        network.see_whole_pictures()
    shaken(network.double(), 0.05)
    before = halves(12)
    after = network(*before)
    assert not torch.allclose(after[0], before[0], atol=0.1)
    for found, expected in zip(network.inverse(*after), before, strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("whole", [False, True])
def test_gradients_of_a_block_both_ways(whole: bool) -> None:
    block = CouplingBlock(3, width=4)
    if whole:
        block.added.see_whole_pictures()
        block.scaled_and_shifted.see_whole_pictures()
    shaken(block.double())
    cover, watermark = (half[:1, :, :3, :3].clone().requires_grad_() for half in halves(3))
    assert torch.autograd.gradcheck(block, (cover, watermark))
    assert torch.autograd.gradcheck(block.inverse, (cover, watermark))


def test_a_new_codec_hides_and_finds_nothing() -> None:
    codec = new_codec(2, 4, seed=0)
    images = torch.rand(2, 3, 8, 10, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(codec.watermark_encoder(images, images.flip(0)), images)
    torch.testing.assert_close(codec.watermark_decoder(images), torch.zeros_like(images))


def test_pictures_with_different_watermarks_differ() -> None:
    codec = shaken(new_codec(1, 4, seed=0))
    assert isinstance(codec, WatermarkCodec)
    images = torch.rand(2, 3, 8, 10, generator=torch.Generator().manual_seed(0))
    one, other = (codec.watermark_encoder(images, watermarks) for watermarks in (images, images.flip(0)))
    assert not torch.allclose(one, other, atol=1e-3)


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


@pytest.mark.parametrize("whole", [False, True])
def test_a_stored_codec_is_the_same(tmp_path: Path, whole: bool) -> None:
    codec = shaken(WatermarkCodec(2, 4, whole))
    assert isinstance(codec, WatermarkCodec)
    images = torch.rand(1, 3, 8, 10, generator=torch.Generator().manual_seed(0))
    read = read_codec(stored(tmp_path / "codec", codec))
    assert torch.equal(read.watermark_decoder(images), codec.watermark_decoder(images))
    assert read.sees_whole_pictures == whole
    assert not any(weight.requires_grad for weight in read.parameters())


def test_what_sees_whole_pictures_starts_as_it_was_and_sees_far() -> None:
    codec = shaken(WatermarkCodec(1, 4))
    assert isinstance(codec, WatermarkCodec)
    images = torch.rand(1, 3, 8, 80, generator=torch.Generator().manual_seed(0))
    changed = torch.cat([images[..., :-8], torch.zeros(1, 3, 8, 8)], dim=-1)
    local = codec.watermark_decoder(images)
    near = slice(0, 8)  # 64 pixels from the change: farther than the convolutions reach
    assert torch.equal(codec.watermark_decoder(changed)[..., near], local[..., near])
    codec.see_whole_pictures()
    assert torch.equal(codec.watermark_decoder(images), local)
    shaken(codec)
    codec.see_whole_pictures()  # calling it again forgets nothing
    found = [codec.watermark_decoder(each)[..., near] for each in (images, changed)]
    assert (found[1] - found[0]).abs().max() > 1e-6


def test_a_decoder_goes_on_from_what_it_learnt_of_a_watermark_of_this_size() -> None:
    codec, watermark = new_codec(1, 4, seed=0), torch.rand(8, 10, 3, generator=torch.Generator().manual_seed(0))
    codec.expect(watermark)
    torch.testing.assert_close(codec.decode(torch.zeros(8, 10, 3)), watermark)
    with torch.no_grad():
        codec.lost += 1
    learnt = codec.lost.detach().clone()
    codec.expect(watermark)
    assert torch.equal(codec.lost, learnt)
    codec.expect(watermark[:, :-2])
    assert codec.lost.shape == (1, 12, 4, 4)


def test_all_of_a_stored_codec_learns_once_it_expects_a_watermark(tmp_path: Path) -> None:
    codec = read_codec(stored(tmp_path / "codec", new_codec(1, 4, seed=0)))
    codec.expect(torch.zeros(8, 10, 3))
    assert all(weight.requires_grad for weight in codec.parameters())


@pytest.mark.parametrize("settings", [{"blocks": 3}, {"sees_whole_pictures": True}, {"width": 5}, {"blocks": "many"}])
def test_weights_that_do_not_fit_are_refused(tmp_path: Path, settings: dict[str, object]) -> None:
    with pytest.raises(UserError, match="do not fit"):
        read_codec(stored(tmp_path / "codec", WatermarkCodec(2, 4), **settings))
