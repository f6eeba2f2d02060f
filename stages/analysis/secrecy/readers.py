"""Message decoders that are not the owner's, and what a message decoder reads in a rendered view.

Everything here is built from what the container publishes: its method, its settings, and how many messages to expect.
Kerckhoffs's principle: an attacker knows the method, and lacks the key and the trained weights alone.
"""

from __future__ import annotations

from typing import cast

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.secrecy.observing import Observed
from stages.hiding.coupled import FEATURES, CoupledFeatures
from stages.hiding.decoders import Decoder, decode
from stages.hiding.method import Method, build_method
from stages.hiding.rendering import COVER

MESSAGE_DECODER = "message_decoder"

WRONG_SEEDS = 1_000_000
"""Seeds of wrong decoders begin here: trainings have small ones, and a start from the same would be no wrong one."""


def seeded_reader(public: Method, messages: int, seed: int) -> Method:
    """The container's method with a message decoder of random weights, drawn from `seed`: the paper's test.

    Weights that the method leaves at zero until its start are drawn, too, since a decoder without them reads nothing.
    torch's global generator is left as it was.
    """
    names = [f"message {number}" for number in range(messages)]
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(seed)
        precise = {"precision": "float32"} if "precision" in public.settings else {}
        reader = build_method(public.name, {**public.settings, **precise, "messages": names})
        for weights in reader.networks[MESSAGE_DECODER].parameters():
            if not weights.any():
                weights.normal_(std=weights.shape[-1] ** -0.5)
    return reader


def started_reader(public: Method, messages: int, seed: int) -> Method:
    """A message decoder as the method itself starts one, untrained, with directions that follow from `seed` and no key.

    A harder test than random weights: from the right seed it is what the owner's training began with.
    Raises `ValueError` where the method has no such start.
    """
    if not has_start(public):
        raise ValueError(f"{public.name} starts its message decoder from random weights")
    reader = seeded_reader(public, messages, seed)
    _start(reader, seed)
    return reader


def attackers_reader(public: Method, messages: int, seed: int) -> Method:
    """What an attacker begins to train: the method's own start with a key of theirs, or else random weights.

    From random weights five layers learn little in a thousand steps, or die: on GS-Hider that made a surrogate worse
    than least squares. `seed` is counted from `WRONG_SEEDS` on.
    """
    make = started_reader if has_start(public) else seeded_reader
    return make(public, messages, WRONG_SEEDS + seed)


def has_start(public: Method) -> bool:
    """Whether the method, when it starts features, sets weights of its message decoder to what the features need."""
    if FEATURES not in public.learning_rates:
        return False
    reader = seeded_reader(public, 1, WRONG_SEEDS)
    weights = list(reader.networks[MESSAGE_DECODER].parameters())
    before = [weight.detach().clone() for weight in weights]
    _start(reader, WRONG_SEEDS)
    return not all(map(torch.equal, before, weights))


def _start(reader: Method, seed: int) -> None:
    grey = {name: np.full((1, 3), 0.5) for name in (COVER, *reader.messages)}
    reader.initial_attributes(grey, np.random.default_rng(seed))


def pixels_beyond(reader: Method) -> int:
    """How far beyond a pixel its message decoder sees: 5 of five 3 x 3 convolutions, 0 of 1 x 1."""
    layers = reader.networks[MESSAGE_DECODER].modules()
    return sum(layer.kernel_size[0] // 2 for layer in layers if isinstance(layer, torch.nn.Conv2d))


def read(reader: Method, seen: Observed) -> Float[Tensor, "L H W 3"]:
    """What the reader's message decoder shows of a view, unclamped, with gradients to its weights."""
    decoder = reader.networks[MESSAGE_DECODER]
    if isinstance(reader, CoupledFeatures):
        [channels] = reader.decoded([decoder], seen.rendering, seen.camera)
    else:  # 3DGS+Decoder reads the picture itself
        channels = decode(cast(Decoder, decoder), seen.rendering.pictures[COVER])
    return torch.stack(channels.split(3, dim=-1))
