"""Journals, which in a bucket may be anyone's: a line that is not in our format counts as not there."""

from __future__ import annotations

import re

import pytest

from pipeline.console.plan_words import print_plan
from tests.pipeline.collecting import collected, is_cached, store_of
from tests.pipeline.helpers import CHAIN, Workspace


@pytest.mark.parametrize("seconds", [f"1{'0' * 400}", "Infinity", "NaN", "1e999", "1.7e308"])
def test_a_line_whose_time_no_stage_can_have_taken_is_not_ours(
    workspace: Workspace, seconds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last of these times is finite, but the sum of several, which `status` tells, is not."""
    workspace.write(CHAIN).run()
    history = store_of(workspace).history
    (journal,) = history.journals("chain")
    lines, changed = re.subn(r'"seconds": [0-9.]+', f'"seconds": {seconds}', journal.read_text())
    journal.write_text(lines)
    assert (changed, history.results(journal)) == (4, {})
    print_plan(workspace.plan(), as_json=False)
    assert capsys.readouterr().out.splitlines()[-1].startswith("4 cached; the cached results took ")
    assert set(workspace.run().states.values()) == {"cached"}
    collected(workspace, keep_last=1)
    assert is_cached(workspace)
