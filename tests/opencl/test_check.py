"""`python -m opencl.check`, which every run calls before it begins."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from opencl import check
from opencl.device import DEVICE_VARIABLE, Device, choose_device, list_devices
from opencl.nvidia import IN_WSL, MISSING_ICD
from tests.opencl.pretended_devices import gpu

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
    """The message does not offer a choice of devices, since there are none; it says only what to install."""
    found: list[Device] = []
    monkeypatch.setattr("opencl.device.list_devices", lambda: found)
    monkeypatch.setattr("opencl.check.list_devices", lambda: found)
    assert check.main() == 2
    assert capsys.readouterr().err == (
        "no OpenCL device found: install one, for a CPU with: pip install 'pyopencl[pocl]'\n"
    )


def way_out() -> str:
    device = choose_device("")
    return f"Or have {device.name} do all the work: {DEVICE_VARIABLE}={device.index}\n"


@pytest.fixture
def nvidia_without_opencl(monkeypatch):
    """NVIDIA's driver starts and torch works with it, but OpenCL sees none of its GPUs."""
    monkeypatch.delenv(DEVICE_VARIABLE, raising=False)
    monkeypatch.delenv(check.VISIBLE_VARIABLE, raising=False)
    monkeypatch.setattr(check, "load_driver", lambda: "a driver")
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "init", lambda: None)
    zeros = torch.zeros
    monkeypatch.setattr(torch, "zeros", lambda count, device: zeros(count))


@pytest.fixture
def nvidia(nvidia_without_opencl, monkeypatch):
    """The same, but OpenCL sees the GPU, too."""
    found = [*list_devices(), gpu()]
    monkeypatch.setattr("opencl.device.list_devices", lambda: found)
    monkeypatch.setattr(check, "list_devices", lambda: found)


def test_a_gpu_that_opencl_does_not_see(nvidia_without_opencl, capsys):
    """A run would copy every tensor to a CPU and draw there, for days."""
    assert check.main() == 2
    assert capsys.readouterr().err == f"{MISSING_ICD}\n{way_out()}"


def test_inside_windows_nothing_is_to_be_installed(nvidia_without_opencl, monkeypatch, tmp_path, capsys):
    """A Linux driver there would take the place of what Windows provides, and CUDA would end as well."""
    (tmp_path / "version").write_text("Linux version 6.6.87.2-microsoft-standard-WSL2 (root@x) (gcc 11.2.0)")
    monkeypatch.setattr("opencl.nvidia._KERNEL", tmp_path / "version")
    assert check.main() == 2
    assert capsys.readouterr().err == f"{IN_WSL}\n{way_out()}"


def test_a_gpu_that_works(nvidia):
    assert check.main() == 0


def no_torch_for_it(monkeypatch):
    monkeypatch.setattr(torch.version, "cuda", None)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


def an_old_driver(monkeypatch):
    def init():
        raise RuntimeError("The NVIDIA driver on your system is too old (found version 12020).\nMore of it.")

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.cuda, "init", init)


def a_driver_that_does_not_start(monkeypatch):
    monkeypatch.setattr(check, "load_driver", start_with("CUDA_ERROR_SYSTEM_DRIVER_MISMATCH (803)"))


def no_kernels_for_it(monkeypatch):
    def zeros(count, device):
        raise RuntimeError("CUDA error: no kernel image is available for execution on the device\nMore of it.")

    monkeypatch.setattr(torch, "zeros", zeros)


def start_with(error):
    def start():
        raise RuntimeError(f"cuInit: {error}")

    return start


FAULTS = {
    no_torch_for_it: f"torch {torch.__version__} is not built for CUDA: install one that is",
    an_old_driver: "GPU (The NVIDIA driver on your system is too old (found version 12020)): install a newer driver",
    a_driver_that_does_not_start: "driver does not start (cuInit: CUDA_ERROR_SYSTEM_DRIVER_MISMATCH (803)): restart",
    no_kernels_for_it: "GPU (CUDA error: no kernel image is available for execution on the device): where it has no",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_gpu_that_torch_does_not_work_on(nvidia, monkeypatch, capsys, fault):
    """A run would use the CPU, for days, without saying so."""
    fault(monkeypatch)
    assert check.main() == 2
    told, _, rest = capsys.readouterr().err.partition("\n")
    assert FAULTS[fault] in told
    assert rest == way_out()


def test_a_gpu_that_is_asked_for_must_work_too(nvidia, monkeypatch, capsys):
    """Otherwise a stage would fail at its first kernel, after others have taken hours."""
    monkeypatch.setenv(DEVICE_VARIABLE, "nvidia")
    assert check.main() == 0
    no_kernels_for_it(monkeypatch)
    assert check.main() == 2
    assert capsys.readouterr().err.endswith(f"\n{way_out()}")
    no_torch_for_it(monkeypatch)
    assert check.main() == 0, "tensors of the CPU are copied to it"


def test_a_gpu_that_others_fill_at_the_moment(nvidia, monkeypatch):
    def zeros(count, device):
        raise RuntimeError("CUDA out of memory. Tried to allocate 2.00 MiB.")

    monkeypatch.setattr(torch, "zeros", zeros)
    assert check.main() == 0


def test_all_that_is_missing_is_told_at_once(nvidia_without_opencl, monkeypatch, capsys):
    no_torch_for_it(monkeypatch)
    assert check.main() == 2
    told = capsys.readouterr().err
    assert "is not built for CUDA" in told
    assert MISSING_ICD in told


@pytest.mark.parametrize("visible", [None, "", "-1"])
@pytest.mark.parametrize("lacks", ["opencl", "torch"])
def test_who_asks_for_the_cpu_gets_it(nvidia_without_opencl, monkeypatch, lacks, visible):
    if lacks == "torch":
        no_torch_for_it(monkeypatch)
    if visible is None:
        monkeypatch.setenv(DEVICE_VARIABLE, choose_device("").index)
    else:
        monkeypatch.setenv(check.VISIBLE_VARIABLE, visible)
    assert check.main() == 0


@pytest.mark.parametrize("lacks", ["driver", "gpu"])
def test_a_cpu_draws_where_there_is_no_gpu(nvidia_without_opencl, monkeypatch, lacks):
    no_torch_for_it(monkeypatch)
    monkeypatch.setattr(
        check, "load_driver", {"driver": lambda: None, "gpu": start_with("CUDA_ERROR_NO_DEVICE")}[lacks]
    )
    assert check.main() == 0


def test_another_makers_gpu_does_the_work(nvidia_without_opencl, monkeypatch):
    monkeypatch.setattr(torch.version, "cuda", None)
    assert check.main() == 0


def test_it_does_not_load_torch():
    """That would take time, while a person waits."""
    script = "import sys, opencl.check; print(sorted({'torch', 'opencl.backend'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
