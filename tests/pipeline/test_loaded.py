"""A process that runs other code than an action's key stands for refuses the action."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.errors import UserError
from pipeline.fingerprint import SourceTree
from pipeline.loaded import LoadedCode, check_engine, engine_digest

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


def planned() -> dict[str, str]:
    """The digests of the modules, as a run that is planned now has them."""
    return dict(SourceTree((PACKAGE,)).code((f"{PACKAGE}.work",)).modules)


def test_sources_that_differ_are_refused(package: Path) -> None:
    loaded, modules = LoadedCode(), planned()
    loaded.check(modules)
    (package / "helper.py").write_text("FACTOR = 2  # a comment\n")
    loaded.check(modules)
    (package / "helper.py").write_text("FACTOR = 3\n")
    with pytest.raises(UserError, match=rf"not those of the run: {PACKAGE}\.helper;"):
        loaded.check(modules)
    (package / "helper.py").unlink()
    with pytest.raises(UserError, match=rf"not those of the run: {PACKAGE}\.helper;"):
        loaded.check(modules)


def test_what_counts_is_what_was_imported(package: Path) -> None:
    """A worker that lives from run to run does not notice that a module was edited; this does."""
    loaded, before = LoadedCode(), planned()
    loaded.check(before)
    importlib.import_module(f"{PACKAGE}.work")
    loaded.remember(before)
    (package / "helper.py").write_text("FACTOR = 3\n")
    loaded.check(before)
    with pytest.raises(UserError, match=rf"loaded an older or newer version of {PACKAGE}\.helper.*Restart the workers"):
        loaded.check(planned())
    for name in before:
        sys.modules.pop(name, None)
    loaded.check(planned())


def test_the_engine_is_compared_too() -> None:
    check_engine(engine_digest())
    with pytest.raises(UserError, match="another version of the engine"):
        check_engine("0" * 64)
