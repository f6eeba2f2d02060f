"""The seeds over which figures are averaged."""

from __future__ import annotations

import pytest

from stages.attack import AttackParameters
from stages.probe_secrecy import ProbeSecrecyParameters


@pytest.mark.parametrize("parameters", [AttackParameters, ProbeSecrecyParameters])
def test_each_seed_is_there_once_and_not_negative(
    parameters: type[AttackParameters | ProbeSecrecyParameters],
) -> None:
    assert parameters.model_validate({"seeds": (3, 0)}).seeds == (3, 0)
    with pytest.raises(ValueError, match="listed twice"):
        parameters.model_validate({"seeds": (1, 0, 1)})
    with pytest.raises(ValueError, match="greater than or equal to 0"):
        parameters.model_validate({"seeds": (-1,)})
