"""A process whose code is not that which an action's key stands for refuses the action."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.code.engine_code import check_engine, engine_digest
from pipeline.code.fingerprint import Code, SourceTree
from pipeline.code.loaded_code import LoadedCode
from pipeline.errors import UserError

PACKAGE = "package_of_a_worker"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / PACKAGE
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "work.py").write_text(f"from {PACKAGE} import helper\n")
    (folder / "helper.py").write_text("FACTOR = 2\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == PACKAGE]:
        del sys.modules[name]


def planned() -> Code:
    """The code behind a stage, as a run planned now sees it."""
    return SourceTree((PACKAGE,)).code((f"{PACKAGE}.work",))


def test_sources_that_differ_are_refused(package: Path) -> None:
    code = planned()
    LoadedCode(code).check()
    (package / "helper.py").write_text("FACTOR = 2  # a comment\n")
    LoadedCode(code).check()
    (package / "helper.py").write_text("FACTOR = 3\n")
    with pytest.raises(UserError, match=rf"found another version of {PACKAGE}\.helper\b"):
        LoadedCode(code).check()
    (package / "helper.py").unlink()
    with pytest.raises(UserError, match=rf"found another version of {PACKAGE}\.helper\b"):
        LoadedCode(code).check()


def test_what_counts_is_what_was_imported(package: Path) -> None:
    """A worker that lives from run to run does not notice that a module was edited; this check does."""
    before = planned()
    importlib.import_module(f"{PACKAGE}.work")
    LoadedCode(before).check()
    (package / "helper.py").write_text("FACTOR = 3\n")
    LoadedCode(before).check()
    with pytest.raises(UserError, match=rf"found another version of {PACKAGE}\.helper\b.*run again"):
        LoadedCode(planned()).check()
    for name in before.modules:
        sys.modules.pop(name, None)
    LoadedCode(planned()).check()


def test_what_another_stage_loaded_counts_too(package: Path) -> None:
    """Remarks load code after the last check, and so may a stage that fails before its first."""
    (package / "other.py").write_text("")
    other = SourceTree((PACKAGE,)).code((f"{PACKAGE}.other",))
    importlib.import_module(f"{PACKAGE}.work")
    LoadedCode(other).look()
    before = planned()
    (package / "helper.py").write_text("FACTOR = 3\n")
    with pytest.raises(UserError, match=rf"found another version of {PACKAGE}\.helper\b"):
        LoadedCode(planned()).check()
    LoadedCode(before).check()
    (package / "broken.py").write_text("")
    importlib.import_module(f"{PACKAGE}.broken")
    (package / "broken.py").write_text("no Python")
    LoadedCode(before).check()


def test_the_engine_is_compared_too() -> None:
    check_engine(engine_digest())
    with pytest.raises(UserError, match="different version of the engine"):
        check_engine("0" * 64)
