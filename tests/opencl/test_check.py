"""`python -m opencl.check`, which a run asks before it begins."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from opencl import check
from opencl.device import DEVICE_VARIABLE, Device, choose_device
from opencl.nvidia import MISSING_ICD

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


@pytest.fixture
def nvidia_without_opencl(monkeypatch):
    """NVIDIA's driver starts and torch is built for it, but OpenCL sees none of its GPUs."""
    monkeypatch.delenv(DEVICE_VARIABLE, raising=False)
    monkeypatch.setattr(check, "load_driver", lambda: "a driver")
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)


def test_a_gpu_that_opencl_does_not_see(nvidia_without_opencl, capsys):
    """A run would copy every tensor to a CPU and be drawn there, for days."""
    device = choose_device("")
    assert check.main() == 2
    assert capsys.readouterr().err == (
        f"{MISSING_ICD}\nOr have {device.name} do all the work: {DEVICE_VARIABLE}={device.index}\n"
    )


def test_who_asks_for_the_cpu_gets_it(nvidia_without_opencl, monkeypatch):
    monkeypatch.setenv(DEVICE_VARIABLE, choose_device("").index)
    assert check.main() == 0


@pytest.mark.parametrize("lacks", ["driver", "a driver that starts", "torch for it", "gpu"])
def test_a_cpu_draws_where_torch_works_on_it(nvidia_without_opencl, monkeypatch, lacks):
    def start():
        if lacks == "a driver that starts":
            raise RuntimeError("cuInit: CUDA_ERROR_NO_DEVICE")
        return None if lacks == "driver" else "a driver"

    monkeypatch.setattr(check, "load_driver", start)
    monkeypatch.setattr(torch.version, "cuda", None if lacks == "torch for it" else "13.0")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: lacks != "gpu")
    assert check.main() == 0


def test_it_does_not_load_torch():
    """A person waits for it."""
    script = "import sys, opencl.check; print(sorted({'torch', 'opencl.backend'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
