"""What attacks left of containers, by method: the figures that tables of robustness are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from stages.analysis.attacks.catalogue import AttackName
from stages.analysis.page.material import GS_HIDER, OURS
from stages.analysis.paper.attack_curves import Curve, Reading, curves, measured, most_to_lose
from stages.analysis.paper.chapter import title_of
from stages.analysis.paper.measuring import Measured
from stages.analysis.paper.runs import Experiment

COMPARED = (OURS, GS_HIDER)
"""The widths of curves are those that both of these reach."""

SEALED = "sealed"
"""The setting of a container that is attacked as it is published; see `stages.seal`."""


@dataclass(frozen=True)
class Attacked:
    """The experiments of attacks, as `runs.by_method` groups them, and the attacks that any of them measured."""

    by_method: Mapping[str, tuple[Experiment, ...]]
    attacks: tuple[AttackName, ...]

    @property
    def captures(self) -> tuple[str, ...]:
        """All that any method was attacked on, in order."""
        return tuple(dict.fromkeys(each.capture for group in self.by_method.values() for each in group))

    @property
    def titles(self) -> tuple[str, ...]:
        """Of the methods."""
        return tuple(map(title_of, self.by_method))

    @property
    def ours(self) -> tuple[str, ...]:
        """The methods, with their settings, that are ours."""
        return tuple(method for method, group in self.by_method.items() if group[0].method == OURS)

    @property
    def is_any_sealed(self) -> bool:
        """Whether containers among them were sealed before they were attacked."""
        return any(SEALED in dict(group[0].settings) for group in self.by_method.values())

    def width(self, attack: AttackName) -> float:
        """Up to which loss of the cover the compared methods' curves reach, or all where neither is there; in dB."""
        methods = [method for method in COMPARED if self._curves(method, attack)] or list(self.by_method)
        reaches = [curve.reach for method in methods for curve in self._curves(method, attack)]
        return min(reaches, default=0.0)

    def message_left(self, method: str, attack: AttackName, reading: Reading) -> Measured:
        """The area under the method's curve, over its width: the message's mean PSNR, in dB."""
        width = self.width(attack)
        return measured(self.by_method.get(method, ()), attack, reading, lambda curve: curve.message_left(width))

    def message_lost(self, method: str, attack: AttackName, reading: Reading) -> Measured:
        """What `message_left` is under the message as it was before the attack, in dB."""
        width, experiments = self.width(attack), self.by_method.get(method, ())
        return measured(
            experiments, attack, reading, lambda curve: curve.unattacked.message - curve.message_left(width)
        )

    def gain(self, method: str, attack: AttackName, reading: Reading, is_floored: bool = True) -> Measured:
        """What the attacker gains: the message's loss less the cover's, in dB; `is_floored` as in `readings`."""
        return measured(self.by_method.get(method, ()), attack, reading, lambda curve: curve.gain, is_floored)

    def most_to_lose(self, method: str) -> Measured:
        """What no gain can exceed: how far the message was above a picture of one colour, in dB."""
        return most_to_lose(self.by_method.get(method, ()))

    def _curves(self, method: str, attack: AttackName) -> list[Curve]:
        return [curve for each in self.by_method.get(method, ()) for curve in curves(each, attack)]
