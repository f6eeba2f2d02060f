"""Files in the user's data folder may complete parameters: what this changes is made again, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.code.declaration import check_completed, import_stage, validate
from pipeline.data_folder import data_files
from pipeline.errors import UserError
from tests.pipeline.helpers import TOYS, Workspace

WORKFLOW = """
    name: measuring
    stages:
      count: {uses: equipped}
      double: {uses: scale, in: {numbers: count}}
      other: {uses: numbers}
"""


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GS_HIDER_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


def test_what_was_made_without_is_made_again_with(tmp_path: Path, data: Path) -> None:
    workspace = Workspace(tmp_path).write(WORKFLOW)
    assert workspace.run().values("double") == [6]
    data.mkdir()
    (data / "instrument").touch()
    ran = workspace.run()
    assert ran.states == {"count": "ran", "double": "ran", "other": "cached"}
    assert ran.values("double") == [6.28]
    (data / "instrument").unlink()
    assert set(workspace.run().states.values()) == {"cached"}
    assert workspace.run("count.precise=false").values("double") == [6]


def test_a_machine_that_lacks_what_the_plan_counts_on_says_so(data: Path) -> None:
    declared = import_stage(TOYS, "equipped")
    parameters = validate(declared, {"precise": True})
    check_completed(declared, parameters, {"precise": False})
    with pytest.raises(UserError, match=r"'precise'.*found false; expected true\. Install the same"):
        check_completed(declared, parameters, {"precise": True})


def test_a_folder_that_cannot_be_listed_holds_nothing(data: Path) -> None:
    assert data_files() == []
    data.write_text("a file")
    assert data_files() == []
