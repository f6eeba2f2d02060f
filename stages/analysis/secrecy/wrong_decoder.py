"""Wrong message decoders: randomly initialised ones, as in the paper's figure, and harder near-misses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.secrecy.conditions import OTHER_START, OWN_START, RANDOM
from stages.analysis.secrecy.observing import Observed
from stages.analysis.secrecy.readers import WRONG_SEEDS, has_start, read, seeded_reader, started_reader
from stages.hiding.method import Method


@dataclass(frozen=True)
class WrongReading:
    """The messages that a wrong decoder of this condition and seed shows in every view."""

    condition: str
    seed: int
    readings: list[Float[Tensor, "L H W 3"]]


@torch.no_grad()
def wrong_readings(
    public: Method, views: Sequence[Observed], count: int, start_seed: int | None, after_each: Callable[[], None]
) -> Iterator[WrongReading]:
    """Readings by `count` randomly initialised decoders and, if the method has a start of its own, by as many started
    with another key, and by one started from the training's own `start_seed`, if given. At least one view is needed.
    """
    messages = len(views[0].truths)
    started = has_start(public)
    makers: list[tuple[str, int, Callable[[Method, int, int], Method]]] = [
        *((RANDOM, WRONG_SEEDS + number, seeded_reader) for number in range(count)),
        *((OTHER_START, WRONG_SEEDS + number, started_reader) for number in range(count if started else 0)),
        *([(OWN_START, start_seed, started_reader)] if started and start_seed is not None else []),
    ]
    for condition, seed, make in makers:
        reader = make(public, messages, seed)
        yield WrongReading(condition, seed, [read(reader, seen) for seen in views])
        after_each()
