"""A surrogate: a message decoder that an attacker trains on some leaked views of the message.

The attacker has the container and can render its feature map from any camera. Each leaked picture of the message makes
a training pair; the aim is to see the message in all other views. The owner's decoder was trained on the same kind of
pairs, but together with the Gaussians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from numpy.random import Generator
from torch import Tensor

from stages.analysis.secrecy.observing import Observed
from stages.analysis.secrecy.readers import pixels_beyond, read
from stages.hiding.method import Method
from stages.hiding.networks import MESSAGE_DECODER
from stages.training.adam import Adam


@dataclass(frozen=True)
class SurrogateSettings:
    """Settings of a surrogate's training.

    Each of `steps` steps sees one square of `crop` pixels a side. Adam's `rate` falls to 0 in a half cosine.
    """

    steps: int
    crop: int
    rate: float


def seen_views(views: Sequence[str], share: float, seed: int) -> tuple[str, ...]:
    """The views that leaked: a random `share` of `views`, at least one unless the share is 0 or there are no views.

    With the same seed, a larger share includes the views of a smaller one.
    """
    count = min(len(views), max(1, round(share * len(views)))) if share > 0 else 0
    order = np.random.default_rng(seed).permutation(len(views))
    return tuple(views[index] for index in order[:count])


def train_surrogate(
    reader: Method,
    seen: Sequence[Observed],
    settings: SurrogateSettings,
    seed: int,
    after_each: Callable[[], None],
) -> list[float]:
    """Train the reader's message decoder on the `seen` views for least squared error; returns every step's loss.

    `seed` determines the squares. The decoder also sees the pixels around a square, as far as its receptive field
    reaches. Otherwise it would learn from zero padding where whole pictures have none. The views may be on the CPU
    whatever the device of the reader's networks. Raises `ValueError` if no view was seen.
    """
    if not seen:
        raise ValueError("without a view there is nothing to train on")
    generator = np.random.default_rng(seed)
    decoder = reader.networks[MESSAGE_DECODER].requires_grad_()
    adam = Adam(decoder.parameters(), lr=settings.rate)
    margin, device = pixels_beyond(reader), next(decoder.parameters()).device
    losses = []
    for step in range(settings.steps):
        adam.param_groups[0]["lr"] = settings.rate * 0.5 * (1 + math.cos(math.pi * step / settings.steps))
        square = _random_square(seen[int(generator.integers(len(seen)))], settings.crop, margin, generator)
        loss = square.to(device).error(reader)
        adam.zero_grad(set_to_none=True)
        loss.backward()
        adam.step()
        losses.append(loss.item())
        after_each()
    decoder.requires_grad_(False)
    return losses


@dataclass(frozen=True)
class _Square:
    """What a step sees: `observed` includes the margin; only `rows` and `columns`, inside it, count in the loss."""

    observed: Observed
    rows: slice
    columns: slice

    def to(self, device: torch.device) -> _Square:
        """A copy on a device."""
        return replace(self, observed=self.observed.to(device))

    def error(self, reader: Method) -> Float[Tensor, ""]:
        """The mean squared error inside the margin."""
        difference = read(reader, self.observed) - self.observed.truths
        return difference[:, self.rows, self.columns].square().mean()


def _random_square(seen: Observed, side: int, margin: int, generator: Generator) -> _Square:
    """A random square of the picture with a margin around it, both cut at the picture's borders."""
    inside, around = [], []
    for length in seen.coverage.shape[1:]:
        first = int(generator.integers(max(length - side, 0) + 1))
        last = min(first + side, length)
        start, stop = max(first - margin, 0), min(last + margin, length)
        inside.append(slice(first - start, last - start))
        around.append((start, stop - start))
    (row, height), (column, width) = around
    return _Square(seen.crop(row, column, height, width), *inside)
