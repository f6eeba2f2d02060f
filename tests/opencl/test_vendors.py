"""NVIDIA's OpenCL is named to the loader if nothing else names it. Here, another library stands in for it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from opencl import vendors
from opencl.vendors import nvidia_named
from tests.opencl.runtimes import OCLGRIND, ROOT

HERE = "libc.so.6"
"""A library that is on every machine."""


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The folder of installed ICD files; the environment names none, and the library is on this machine."""
    for name in vendors.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(vendors, "FOLDERS", (tmp_path, tmp_path / "none"))
    monkeypatch.setattr(vendors, "LIBRARY", HERE)
    return tmp_path


def named() -> list[str] | None:
    """The contents of the files that the loader is shown; None if it looks in its usual folders."""
    with nvidia_named():
        shown = os.environ.get("OCL_ICD_VENDORS")
        files = None if shown is None else sorted(path.read_text() for path in Path(shown).glob("*.icd"))
    assert os.environ.get("OCL_ICD_VENDORS") is None
    assert shown is None or not Path(shown).exists()
    return files


def test_beside_what_is_installed(folder: Path) -> None:
    (folder / "pocl.icd").write_text("libpocl.so.2\n")
    assert named() == [f"{HERE}\n", "libpocl.so.2\n"]


def test_where_nothing_is_installed(folder: Path) -> None:
    assert named() == [f"{HERE}\n"]


@pytest.mark.parametrize("said", ["libnvidia-opencl.so.1", "/usr/lib/libNVIDIA-opencl.so"])
def test_not_where_it_is_installed(folder: Path, said: str) -> None:
    (folder / "vendor.icd").write_text(said)
    assert named() is None


@pytest.mark.usefixtures("folder")
def test_not_where_there_is_no_such_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vendors, "LIBRARY", "libno-such-library.so.1")
    assert named() is None


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("name", vendors.VARIABLES)
def test_not_where_the_environment_says_what_to_load(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setenv(name, "/own")
    with nvidia_named():
        assert os.environ[name] == "/own"
        assert sum(one in os.environ for one in vendors.VARIABLES) == 1
    assert os.environ[name] == "/own"


def test_files_that_cannot_be_read_are_left_out(folder: Path) -> None:
    (folder / "broken.icd").symlink_to(folder / "nowhere")
    assert named() == ["", f"{HERE}\n"]


def test_the_loader_loads_it_and_keeps_the_others() -> None:
    drivers = sorted(OCLGRIND.glob("pyopencl/.libs/liboclgrind-rt-icd*.so"))
    if not drivers:
        pytest.skip("Oclgrind is not installed: make test fetches it")
    script = f"""
import os
from opencl import vendors
vendors.LIBRARY = {str(drivers[0])!r}
from opencl.device import list_devices
print([device.handle.platform.name for device in list_devices()])
assert not any(name in os.environ for name in vendors.VARIABLES)
"""
    environment = {name: value for name, value in os.environ.items() if name not in vendors.VARIABLES}
    command = [sys.executable, "-c", script]
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True, timeout=600)
    assert "'Oclgrind'" in run.stdout
    assert "'Portable Computing Language'" in run.stdout
