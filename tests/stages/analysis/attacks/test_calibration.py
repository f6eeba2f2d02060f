"""Calibration finds the severities at which an attack does the damage asked for."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from stages.analysis.attacks.calibration import LEAST_LOSS, TOLERANCE, calibrated

AIMS = (0.25, 0.5, 1.0, 2.0, 4.0)


@given(power=st.floats(0.5, 3), strength=st.floats(5, 20))
def test_damage_is_what_was_aimed_at(power: float, strength: float) -> None:
    found = calibrated(lambda severity: strength * severity**power, AIMS, strongest=1.0)
    assert len(found) == len(AIMS)
    for severity, aim in zip(found, AIMS, strict=True):
        assert strength * severity**power == pytest.approx(aim, rel=TOLERANCE + 0.05)


@given(most=st.floats(0.06, 4), power=st.floats(0.5, 3))
@example(most=0.38, power=1)
def test_as_many_severities_are_measured_however_little_the_strongest_does(most: float, power: float) -> None:
    found = calibrated(lambda severity: most * severity**power, AIMS, strongest=1.0)
    assert len(found) == len(AIMS)
    assert found == tuple(sorted(set(found)))
    assert found[-1] == 1.0


def test_aims_out_of_reach_give_way_to_what_halves_the_widest_gaps() -> None:
    found = calibrated(lambda severity: severity, AIMS, strongest=0.75)
    assert found == pytest.approx([0.125, 0.25, 0.375, 0.5, 0.75], rel=TOLERANCE)
    assert calibrated(lambda severity: severity, [0.7, 2.0], strongest=0.7) == pytest.approx((0.35, 0.7), rel=TOLERANCE)


def test_harmless_attacks_are_measured_at_their_strongest() -> None:
    for slope in (0.0, -1.0, 0.01, LEAST_LOSS):
        assert calibrated(lambda severity, slope=slope: slope * severity, AIMS, strongest=0.7) == (0.7,)


def test_a_jump_is_not_measured_again_and_again() -> None:
    found = calibrated(lambda severity: 0.0 if severity < 0.5 else 1.5, AIMS, strongest=1.0)
    assert all(above > 1.01 * each for each, above in pairwise(found))
    assert found[-1] == 1.0


def test_a_jump_is_met_from_its_nearer_side() -> None:
    found = calibrated(lambda severity: 0.0 if severity < 0.3 else 10.0, [1.0], strongest=1.0)
    assert found[0] == pytest.approx(0.3, rel=0.05)
    assert found[0] < 0.3


def test_damage_that_cannot_be_measured_is_larger_than_every_aim() -> None:
    found = calibrated(lambda severity: 8 * severity if severity < 0.6 else math.nan, [1.0, 2.0], strongest=1.0)
    assert [8 * severity for severity in found] == pytest.approx([1.0, 2.0], rel=TOLERANCE)
    assert len(calibrated(lambda severity: math.nan, AIMS, strongest=1.0)) == 1


def test_every_severity_is_looked_at_once() -> None:
    seen: list[float] = []

    def damage(severity: float) -> float:
        seen.append(severity)
        return 8 * severity

    calibrated(damage, AIMS, strongest=1.0)
    assert len(seen) == len(set(seen)) < 30
