"""Every stage says what it is for, and what each of its parameters can be."""

from __future__ import annotations

import pytest

from pipeline.code.manual import manual, summaries
from pipeline.console.stage_words import lines_of_manual


@pytest.mark.parametrize("name", summaries("stages"))
def test_every_stage_has_a_manual(name: str) -> None:
    found = manual("stages", name)
    assert found.summary == summaries("stages")[name] != ""
    assert [each for each, parameter in found.parameters.items() if "any" in parameter.values.split()] == []
    lines = list(lines_of_manual(found))
    assert max(map(len, lines)) <= 120
    assert lines[0].startswith(f"{name}: ")


def test_threads_are_described_alike_and_it_is_told_that_bits_may_depend_on_them() -> None:
    found = [manual("stages", name).parameters.get("threads") for name in summaries("stages")]
    [said] = {threads.description for threads in found if threads is not None}
    assert "bits may depend on it" in said
