"""Results of attacks on containers, by method: the figures of the robustness tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from stages.analysis.attacks.catalogue import AttackName
from stages.analysis.method_titles import GS_HIDER, OURS
from stages.analysis.paper.attack_curves import Reading, curves, mean_over_seeds, measured, message_left, most_to_lose
from stages.analysis.paper.chapter import title_of
from stages.analysis.paper.measuring import Measured
from stages.analysis.paper.runs import Experiment

COMPARED = (OURS, GS_HIDER)
"""Curves are compared up to the largest loss of the cover that those of these methods reach, with any settings."""

LEAST_WIDTH = 0.25
"""In dB: curves are compared at least this far; those that end before continue level. Re-optimisation can cost one
cover nothing and another a tenth of a decibel; compared at no loss at all, it would seem to spare the other's message,
of which it takes as much."""

SEALED = "sealed"
"""The setting of a container that is attacked as it is published, sealed; see `stages.seal`."""


@dataclass(frozen=True)
class Attacked:
    """Experiments with attacks, grouped as by `runs.by_method`, and the attacks that any of them measured."""

    by_method: Mapping[str, tuple[Experiment, ...]]
    attacks: tuple[AttackName, ...]

    @property
    def captures(self) -> tuple[str, ...]:
        """All captures on which any method was attacked, in order."""
        return tuple(dict.fromkeys(each.capture for group in self.by_method.values() for each in group))

    @property
    def titles(self) -> tuple[str, ...]:
        """Titles of the methods."""
        return tuple(map(title_of, self.by_method))

    def kinds(self, *methods: str) -> tuple[str, ...]:
        """The keys of `by_method` that are one of these methods, with any settings, sealed or not."""
        return tuple(key for key, group in self.by_method.items() if group[0].method in methods)

    @property
    def is_any_sealed(self) -> bool:
        """Whether any container was sealed before it was attacked."""
        return any(SEALED in dict(group[0].settings) for group in self.by_method.values())

    def widths(self, attack: AttackName) -> Mapping[str, float]:
        """For each capture, the loss of the cover, in dB, that the mean curves of the compared methods all reach.

        It is at least `LEAST_WIDTH`. Where none of these has a curve, it is that of all methods; captures without any
        curve are left out.
        """
        compared = self.kinds(*COMPARED)
        found = {}
        for capture in self.captures:
            reaches = self._reaches(compared, attack, capture) or self._reaches(self.by_method, attack, capture)
            if reaches:
                found[capture] = max(LEAST_WIDTH, min(reaches))
        return found

    def message_left(self, method: str, attack: AttackName, reading: Reading) -> Measured:
        """The message's mean PSNR, in dB: the area under the method's curve, over its width."""
        return message_left(self.by_method.get(method, ()), attack, reading, self.widths(attack))

    def message_lost(self, method: str, attack: AttackName, reading: Reading) -> Measured:
        """The message's PSNR before the attack minus `message_left`, in dB."""
        before = measured(self.by_method.get(method, ()), attack, reading, lambda curve: curve.unattacked.message)
        return before.minus(self.message_left(method, attack, reading))

    def gain(self, method: str, attack: AttackName, reading: Reading, is_floored: bool = True) -> Measured:
        """The attacker's gain, the message's loss minus the cover's, in dB; `is_floored` as in `readings`."""
        return measured(self.by_method.get(method, ()), attack, reading, lambda curve: curve.gain, is_floored)

    def most_to_lose(self, method: str) -> Measured:
        """The upper bound of gains: how far the message exceeded the best single colour, in dB."""
        return most_to_lose(self.by_method.get(method, ()))

    def _reaches(self, methods: Iterable[str], attack: AttackName, capture: str) -> list[float]:
        """The reach of each container's mean curve on one capture, in dB."""
        return [
            mean_over_seeds(found).reach
            for method in methods
            for each in self.by_method[method]
            if each.capture == capture and (found := curves(each, attack))
        ]
