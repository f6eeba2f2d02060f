"""Attacks as curves: the quality of cover and messages at each severity, for every seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from stages.analysis.attacks.calibration import calibrated
from stages.analysis.attacks.catalogue import UNATTACKED, restored
from stages.analysis.attacks.restoring import restored_target
from stages.analysis.attacks.scoring import Figures, Scorer
from stages.analysis.attacks.target import Attack, Attacker, Knowledge, Target
from stages.analysis.fidelity import Perceptual
from stages.analysis.measurements import Measurement


@dataclass(frozen=True)
class Assay:
    """A setup for measuring attacks: the target, the scorer, and what the attacker knows.

    Attacks without natural severities are measured where the cover loses `cover_losses`, in dB, with the first seed.
    The `perceptual` metrics are measured only without attack, and at fixed severities with the first seed.
    """

    target: Target
    scorer: Scorer
    knowledge: Knowledge
    method: str
    cover_losses: Sequence[float]
    seeds: Sequence[int]
    perceptual: Perceptual
    after_each: Callable[[], None]

    def unattacked(self) -> Iterator[Measurement]:
        """Rows of the unattacked container, and of the best single-colour picture of each message."""
        figures = {**self.scorer.figures(self.target, self.perceptual), **self.scorer.one_colour()}
        return self._rows(figures, UNATTACKED, None, None)

    def curve(self, name: str, attack: Attack) -> Iterator[Measurement]:
        """Rows of the attacked container and, except for attacks on renders, of what its owner restores from it.

        There are none if the attack does not apply to the target.
        """
        if not attack.applies(self.target):
            return
        first, *others = self.seeds if attack.random else self.seeds[:1]
        attacker = attack.prepare(self.target, first, self.knowledge)
        severities = self._severities(attack, attacker)
        yield from self._of_seed(name, attack, attacker, severities, first)
        del attacker  # a training can fill a GPU: let none live while the next is prepared
        for seed in others:
            yield from self._of_seed(name, attack, attack.prepare(self.target, seed, self.knowledge), severities, seed)

    def _of_seed(
        self, name: str, attack: Attack, attacker: Attacker, severities: Sequence[float], seed: int
    ) -> Iterator[Measurement]:
        for severity in severities:
            attacked = attacker(severity)
            perceptual = self.perceptual if severity in attack.fixed and seed == self.seeds[0] else {}
            found = self.scorer.figures(attacked, perceptual)
            yield from self._rows(found, name, severity, seed)
            if attacked.on_pictures is None:
                yield from self._rows(self._restored(attacked, found), restored(name), severity, seed)
            self.after_each()

    def _restored(self, attacked: Target, found: Figures) -> Figures:
        """The figures after the owner's restoration, without perceptual ones; those `found` if it changes nothing."""
        target = restored_target(attacked, self.target, self.seeds[0])
        if target is not attacked:
            return self.scorer.figures(target)
        return {key: value for key, value in found.items() if key[1] not in self.perceptual}

    def _severities(self, attack: Attack, attacker: Attacker) -> tuple[float, ...]:
        if attack.severities is not None:
            return tuple(attack.severities(self.target))
        unharmed = self.scorer.cover_psnr(self.target)

        def damage(severity: float) -> float:
            self.after_each()
            return unharmed - self.scorer.cover_psnr(attacker(severity))

        return tuple(sorted({*calibrated(damage, self.cover_losses, attack.strongest), *attack.fixed}))

    def _rows(
        self, figures: Figures, condition: str, severity: float | None, seed: int | None
    ) -> Iterator[Measurement]:
        for (message, quantity), value in figures.items():
            yield Measurement(
                quantity,
                value,
                condition,
                severity,
                seed,
                split="test",
                message=message,
                method=self.method,
            )
