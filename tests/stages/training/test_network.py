"""Training a network: what a step keeps in memory, and what is said when there is too little of it."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from pipeline.checkpoint import State
from pipeline.errors import Interrupted, UserError
from pipeline.stage import Context, Services
from stages.hiding.watermark.codec import new_codec
from stages.training.codec import CodecSettings, CodecTraining
from stages.training.decoder_tuning import PHOTOS, RENDERS, DecoderTuning, TuningSettings
from stages.training.imprinting import Imprinting, ImprintPictures, ImprintSettings
from stages.training.network import NetworkTraining, train_network
from tests.stages.training.trainings import HEIGHT, WIDTH, prepared

PICTURES = np.random.default_rng(0).integers(0, 256, (3, HEIGHT, WIDTH, 3), dtype=np.uint8)


class Kept:
    """A tensor that is kept for a backward pass, for as long as it is."""

    def __init__(self, tensor: Tensor) -> None:
        self.tensor = tensor


def peak_of_a_step(training: NetworkTraining) -> int:
    """The most elements that tensors kept for backward passes have at once."""
    now, peak = 0, 0

    def keep(tensor: Tensor) -> Kept:
        nonlocal now, peak
        kept, size = Kept(tensor), tensor.numel()
        now += size
        peak = max(peak, now)
        weakref.finalize(kept, let_go, size)
        return kept

    def let_go(size: int) -> None:
        nonlocal now
        now -= size

    with torch.autograd.graph.saved_tensors_hooks(keep, lambda kept: kept.tensor):
        training.step()
    assert now == 0
    return peak


def tuning(batch: int, photos_of_others: int) -> DecoderTuning:
    shown = {RENDERS: PICTURES, PHOTOS: PICTURES}
    others = [[picture] for picture in PICTURES[:photos_of_others]]
    return DecoderTuning(new_codec(1, 4, seed=0), PICTURES[0], shown, TuningSettings(3, seed=0, batch=batch), others)


def imprinting(others: int) -> Imprinting:
    hiding = prepared("plain", 3)
    pictures = ImprintPictures(hiding.views, [*PICTURES], PICTURES[0], [*PICTURES[:others]])
    before = prepared("plain", 3)
    settings = ImprintSettings(3, seed=0, level=2)
    return Imprinting(hiding.gaussians, before.gaussians, hiding.method, new_codec(1, 4, seed=0), pictures, settings)


def codec_training() -> CodecTraining:
    return CodecTraining(new_codec(1, 4, seed=0), [*PICTURES], [], CodecSettings(6, seed=0, batch=1, window=8))


def test_a_decoder_is_tuned_in_the_memory_of_one_picture() -> None:
    one = peak_of_a_step(tuning(batch=1, photos_of_others=0))
    assert peak_of_a_step(tuning(batch=3, photos_of_others=2)) == one


def test_pictures_that_must_show_black_need_no_memory_beside_the_render() -> None:
    assert peak_of_a_step(imprinting(others=2)) == peak_of_a_step(imprinting(others=0))


class Terms(NetworkTraining):
    """One number of value 0.1, and two errors: one in two terms, whose gradients are 0.1 and 0.2, and its square."""

    def __init__(self) -> None:
        self.number = torch.nn.Parameter(torch.tensor([0.1]))
        super().__init__(torch.nn.ParameterList([self.number]), {"in terms": 1.0, "square": 2.0}, 3, 1e-3, 1e-4)

    def errors(self, iteration: int) -> Iterator[dict[str, Tensor]]:
        yield {"in terms": 0.1 * self.number.sum()}
        yield {"square": self.number.square().sum()}
        yield {"in terms": 0.2 * self.number.sum()}


def test_an_error_that_comes_in_terms_is_their_sum() -> None:
    training = Terms()
    training.step()
    assert training.history == [pytest.approx([0.03, 0.01])]
    mean_gradient = training.adam.state[training.number]["exp_avg"]
    assert mean_gradient.item() == pytest.approx((1 - 0.9) * (0.1 + 0.2 + 2 * 0.2))


def test_a_training_that_goes_on_lets_its_checkpoint_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = iter([False, True])
    with pytest.raises(Interrupted):
        train_network(Context({}, {}, tmp_path, "test", Services(stop_requested=lambda: next(looks))), codec_training())
    set_state, step = CodecTraining.set_state, CodecTraining.step
    given: list[weakref.ref[State]] = []
    held: list[State | None] = []

    def remembered(training: CodecTraining, state: State) -> None:
        given.append(weakref.ref(state))
        set_state(training, state)

    def watched(training: CodecTraining) -> None:
        held.append(given[0]())
        step(training)

    monkeypatch.setattr(CodecTraining, "set_state", remembered)
    monkeypatch.setattr(CodecTraining, "step", watched)
    train_network(Context({}, {}, tmp_path, "test", Services()), codec_training())
    assert held == [None] * 4


def test_a_gpu_that_is_too_small_is_told_with_what_to_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    training = codec_training()
    decode = training.codec.watermark_decoder

    def full(pictures: Tensor) -> Tensor:
        if training.iteration == 3:
            raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.\nSee the documentation.")
        return decode(pictures)

    monkeypatch.setattr(training.codec, "watermark_decoder", full)
    with pytest.raises(UserError, match=r"too little memory .* found CUDA out of memory.*2.00 GiB") as told:
        train_network(Context({}, {}, tmp_path, "test", Services()), training)
    assert str(told.value).startswith("step 4: ")
    assert "--workers 1" in str(told.value)
    assert str(told.value).endswith("choose a smaller batch or window.")
