"""Names, descriptions and attacks belong together."""

from __future__ import annotations

from typing import get_args

from stages.analysis.attacks.catalogue import ATTACKS, AttackName
from stages.analysis.attacks.registry import attacks


def test_every_attack_that_has_a_name_is_described_and_there() -> None:
    assert {*attacks([1])} == {*ATTACKS} == {*get_args(AttackName)}
