"""A surrogate: an attacker has some of the message's views, and trains a message decoder of their own on them.

They have the container, and render its feature map of any view. With a view's picture of the message they have a pair
to learn from; what they want are all the other views. The owner's decoder learnt from the same pairs, but together
with the Gaussians.
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
from stages.analysis.secrecy.readers import MESSAGE_DECODER, pixels_beyond, read
from stages.hiding.method import Method
from stages.training.adam import Adam


@dataclass(frozen=True)
class SurrogateSettings:
    """`rate` is Adam's, and falls to nothing over all `steps`; each step learns from one square of `crop` pixels a
    side."""

    steps: int
    crop: int
    rate: float


def seen_views(views: Sequence[str], share: float, seed: int) -> tuple[str, ...]:
    """The views that leaked: this share of them, drawn at random; at least one, unless the share is zero.

    With one seed, those of a smaller share are among those of a larger one.
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
    """Train the reader's message decoder on the `seen` views, to the least squared error; the loss of every step.

    `seed` decides the squares. A decoder is given as many pixels around a square as it sees beyond one: where it would
    find zeros in their place, as at no such place of a whole picture, it would learn what is of no use. The views may
    be on the CPU, whatever device the reader's networks are on. Raises `ValueError` without any view.
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
    """What a step learns from: `observed` with pixels around it, and which of its `rows` and `columns` are judged."""

    observed: Observed
    rows: slice
    columns: slice

    def to(self, device: torch.device) -> _Square:
        """The same there."""
        return replace(self, observed=self.observed.to(device))

    def error(self, reader: Method) -> Float[Tensor, ""]:
        """The mean squared error inside."""
        difference = read(reader, self.observed) - self.observed.truths
        return difference[:, self.rows, self.columns].square().mean()


def _random_square(seen: Observed, side: int, margin: int, generator: Generator) -> _Square:
    """A square anywhere in the picture, with a margin as far as the picture reaches."""
    inside, around = [], []
    for length in seen.coverage.shape[1:]:
        first = int(generator.integers(max(length - side, 0) + 1))
        last = min(first + side, length)
        start, stop = max(first - margin, 0), min(last + margin, length)
        inside.append(slice(first - start, last - start))
        around.append((start, stop - start))
    (row, height), (column, width) = around
    return _Square(seen.crop(row, column, height, width), *inside)
