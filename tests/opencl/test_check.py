"""`python -m opencl.check`, which a run asks before it begins."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from opencl import check
from opencl.device import DEVICE_VARIABLE, Device, choose_device

ROOT = Path(__file__).parents[2]


def asked(**changes):
    command = [sys.executable, "-m", "opencl.check"]
    return subprocess.run(command, cwd=ROOT, env={**os.environ, **changes}, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", ["", "0:0", "portable computing"])
def test_a_device_that_is_there(name):
    done = asked(**{DEVICE_VARIABLE: name})
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_one_that_is_not():
    done = asked(**{DEVICE_VARIABLE: "nonsense"})
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert "found 'nonsense'" in done.stderr
    assert choose_device("").name in done.stderr


def test_no_driver(monkeypatch, capsys):
    """There is none to choose: what helps is told, and nothing else."""
    found: list[Device] = []
    monkeypatch.setattr("opencl.device.list_devices", lambda: found)
    monkeypatch.setattr("opencl.check.list_devices", lambda: found)
    assert check.main() == 2
    assert capsys.readouterr().err == (
        "no OpenCL device found: install one, for a CPU with: pip install 'pyopencl[pocl]'\n"
    )


def test_it_does_not_load_torch():
    """A person waits for it."""
    script = "import sys, opencl.check; print(sorted({'torch', 'opencl.backend'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
