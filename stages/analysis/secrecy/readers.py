"""Message decoders that are not the owner's, and the readings of a message decoder.

Everything here is built from what the container publishes, its method and settings, and from the number of messages.
By Kerckhoffs's principle, an attacker knows the method, and lacks only the key and the trained weights.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.errors import UserError
from stages.analysis.secrecy.observing import Observed
from stages.hiding.coupled import FEATURES, CoupledFeatures
from stages.hiding.method import Method, ReadsRenders, build_method
from stages.hiding.method_names import module_of
from stages.hiding.networks import MESSAGE_DECODER
from stages.hiding.rendering import COVER

WRONG_SEEDS = 1_000_000
"""The first seed of wrong decoders. Trainings have small seeds, and a decoder started from one would not be wrong."""


def refuse_unreadable(method: Method) -> None:
    """Raise `UserError` if a decoder of the method's messages cannot be given what someone else rendered (`read`)."""
    if MESSAGE_DECODER in method.networks and not isinstance(method, CoupledFeatures | ReadsRenders):
        raise UserError(
            "the secrecy of this method's messages cannot be probed",
            where=module_of(method.name),
            found="a message decoder, and no way to show what it reads from a rendering",
            expected="a subclass of CoupledFeatures, or read_off(picture), as in stages/hiding/methods/decoder.py",
        )


def seeded_reader(public: Method, messages: int, seed: int) -> Method:
    """The container's method with a randomly initialised message decoder, drawn from `seed`: the paper's test.

    Parameters that the method initialises with zeros are drawn as well, since a decoder without them reads nothing. The
    state of torch's global generator is preserved.
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
    """The container's method with an untrained message decoder in the method's own start, drawn from `seed` alone.

    This is a harder test than random weights: with the right seed, and if the owner used no key, it is where the
    owner's training began. Raises `ValueError` if the method has no such start.
    """
    if not has_start(public):
        raise ValueError(f"{public.name} starts its message decoder from random weights")
    reader = seeded_reader(public, messages, seed)
    _start(reader, seed)
    return reader


def attackers_reader(public: Method, messages: int, seed: int) -> Method:
    """The message decoder from which an attacker trains: the method's own start if it has one, or else random weights.

    From random weights, five layers learn little in a thousand steps, or die: on GS-Hider, this made a surrogate worse
    than least squares. `seed` counts from `WRONG_SEEDS`.
    """
    make = started_reader if has_start(public) else seeded_reader
    return make(public, messages, WRONG_SEEDS + seed)


def has_start(public: Method) -> bool:
    """Whether the method initialises its message decoder together with the features, to decode them from the start."""
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
    """The radius of the message decoder's receptive field: 5 pixels for five 3 x 3 convolutions, 0 for 1 x 1."""
    layers = reader.networks[MESSAGE_DECODER].modules()
    return sum(layer.kernel_size[0] // 2 for layer in layers if isinstance(layer, torch.nn.Conv2d))


def read(reader: Method, seen: Observed) -> Float[Tensor, "L H W 3"]:
    """The messages that the reader's message decoder shows in a view, unclamped, with gradients to its weights."""
    if isinstance(reader, ReadsRenders):
        return torch.stack(list(reader.read_off(seen.rendering.pictures[COVER]).values()))
    assert isinstance(reader, CoupledFeatures), "refuse_unreadable refuses others"
    [channels] = reader.decoded([reader.networks[MESSAGE_DECODER]], seen.rendering, seen.camera)
    return torch.stack(channels.split(3, dim=-1))
