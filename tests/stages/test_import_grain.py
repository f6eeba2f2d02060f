"""What was kept of a container with a grain comes back as it was; from two runs, or without grain, it is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import Artifact, load
from pipeline.errors import UserError
from stages.add_grain import AddGrainParameters, add_grain
from stages.draw_key import DrawKeyParameters, draw_key
from stages.import_grain import ImportGrainParameters, import_grain
from tests.running import run_stage
from tests.stages import small


@pytest.fixture
def kept(tmp_path: Path) -> dict[str, Path]:
    """The paths of what the owner keeps, by the parameters that take them."""
    before = small.splats(tmp_path / "before", "container", private=True)
    key = run_stage(draw_key, DrawKeyParameters(seed=1), {}, tmp_path / "key")["key"]
    given = {"container": before, "cover": small.scene(tmp_path / "cover"), "key": key}
    parameters = AddGrainParameters(method="plain")
    after = run_stage(add_grain, parameters, given, tmp_path / "grain", private=True)["container"]
    return {"before": before.path, "after": after.path, "key": key.path}


def imported(folder: Path, kept: dict[str, Path]) -> dict[str, Artifact]:
    return run_stage(import_grain, ImportGrainParameters(method="plain", **kept), {}, folder / "imported")


def test_what_was_kept_comes_back(tmp_path: Path, kept: dict[str, Path]) -> None:
    made = imported(tmp_path, kept)
    assert all(artifact.private for artifact in made.values())
    assert {name: artifact.digest for name, artifact in made.items()} == {
        name: load(kept[name]).digest for name in ("before", "key")
    }


def test_a_container_without_a_grain_is_told(tmp_path: Path, kept: dict[str, Path]) -> None:
    """`find_grain` would find nothing in its renders, and so say that they are not the owner's."""
    with pytest.raises(UserError, match="the container has no grain"):
        imported(tmp_path, kept | {"after": kept["before"]})


def test_the_key_of_another_run_is_told(tmp_path: Path, kept: dict[str, Path]) -> None:
    other = run_stage(draw_key, DrawKeyParameters(seed=2), {}, tmp_path / "other")["key"]
    with pytest.raises(UserError, match="the grain does not match the key"):
        imported(tmp_path, kept | {"key": other.path})


def test_what_is_missing_or_something_else_is_told(tmp_path: Path, kept: dict[str, Path]) -> None:
    with pytest.raises(UserError, match="key missing or damaged"):
        imported(tmp_path, kept | {"key": tmp_path / "nowhere"})
    with pytest.raises(UserError, match=r"not the expected kind of artifact.*found key"):
        imported(tmp_path / "again", kept | {"after": kept["key"]})
