"""Every second belongs to exactly one part, backward passes included, and watching changes no bit."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from stages.timing.stopwatch import OTHER, Stopwatch, backward_of, part, watching


class Clock:
    """A clock that moves only when told to."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def slow(self, forward: float, backward: float) -> Callable[[Tensor], Tensor]:
        """A function that doubles values and takes so many seconds forward and backward."""
        clock = self

        class Slow(torch.autograd.Function):
            @staticmethod
            def forward(context, values: Tensor) -> Tensor:
                clock.now += forward
                return 2 * values

            @staticmethod
            def backward(context, gradient: Tensor) -> Tensor:
                clock.now += backward
                return 2 * gradient

        return Slow.apply


def iteration(clock: Clock) -> Tensor:
    """Three parts, one with an inner part; returns the gradient that reaches the input of the first."""
    values = torch.ones(2, requires_grad=True)
    with part("first"):
        first = clock.slow(1, 10)(values)
        with part("inner"):
            clock.now += 0.5
        clock.now += 0.25
    backward_of("first", first)
    clock.now += 3
    with part("second"):
        second = [clock.slow(2, 20)(first), clock.slow(4, 40)(first)]
    backward_of("second", *second)
    with part("loss"):
        loss = clock.slow(5, 50)(torch.stack(second).sum())
    with part("loss", "backward"):
        loss.backward()
    assert values.grad is not None
    return values.grad


def test_every_part_gets_its_own_time() -> None:
    clock = Clock()
    with watching(Stopwatch(clock)) as stopwatch:
        iteration(clock)
    clock.now += 7
    stopwatch.table(1)
    assert stopwatch.seconds == {
        ("first", "forward"): 1.25,
        ("inner", "forward"): 0.5,
        ("second", "forward"): 6,
        ("loss", "forward"): 5,
        ("loss", "backward"): 50,
        ("second", "backward"): 60,
        ("first", "backward"): 10,
        (OTHER, "forward"): 10,
    }


def test_the_table_is_a_mean_with_the_longest_part_first() -> None:
    clock = Clock()
    with watching(Stopwatch(clock)) as stopwatch:
        for _ in range(2):
            iteration(clock)
    heading, *lines = stopwatch.table(iterations=2).splitlines()
    assert heading == "135750.0 ms an iteration, mean of 2"
    assert [line.split()[0] for line in lines] == ["second", "loss", "first", "other", "inner"]
    assert lines[0].split() == ["second", "48.6", "%", "forward", "6000.00", "ms", "backward", "60000.00", "ms"]


def test_gradients_are_the_same_watched_or_not() -> None:
    with watching(Stopwatch()):
        watched = iteration(Clock())
    assert torch.equal(watched, iteration(Clock()))


def test_unwatched_marks_leave_nothing_on_a_tensor() -> None:
    values = torch.ones(1, requires_grad=True)
    backward_of("part", values)
    with part("part"):
        pass
    assert not values._backward_hooks


def test_without_gradients_there_is_nothing_to_mark() -> None:
    with watching(Stopwatch()):
        backward_of("part", torch.ones(1))


def test_an_error_in_a_part_ends_it() -> None:
    clock = Clock()
    with watching(Stopwatch(clock)) as stopwatch:
        with pytest.raises(ValueError, match="broken"), part("broken"):
            raise ValueError("broken")
        clock.now += 1
    stopwatch.table(1)
    assert stopwatch.seconds[OTHER, "forward"] == 1
