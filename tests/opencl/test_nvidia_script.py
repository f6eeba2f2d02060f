"""`tests.benchmarks.nvidia` from end to end, on a fake driver and fake streams."""

from __future__ import annotations

import inspect
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

import opencl.__main__
import opencl.backend
import opencl.routes
from opencl.backend import Backend
from opencl.bench.view import View
from opencl.bench.workloads import Box, Inputs, box_named
from opencl.device import choose_device
from tests.benchmarks import nvidia, nvidia_checks, nvidia_timing, nvidia_training
from tests.benchmarks.nvidia_training import Size, check_training, prepared
from tests.opencl.fake_cuda import FakeCuda, backend_on
from tests.opencl.runtimes import ROOT
from tests.opencl.scenes import make_scene

CPU = torch.device("cpu")
SMALL = Size(points=40, width=20, height=14, feature_dim=8, layers=2, decoder_width=8)


class Event:
    """A fake CUDA event."""

    def __init__(self, enable_timing):
        assert enable_timing

    def record(self, stream):
        pass

    def synchronize(self):
        pass

    def elapsed_time(self, other):
        return 0.5


@pytest.fixture
def queued(monkeypatch):
    """The names of the calls to torch's fake streams, and to `randn`, in order."""
    asked = []

    def noted(name, function):
        def call(*given, **options):
            asked.append(name)
            return function(*given, **options)

        return call

    for module, name, function in (
        (torch.cuda, "synchronize", lambda: None),
        (torch.cuda, "Stream", lambda: "a stream"),
        (torch.cuda, "stream", lambda stream: nullcontext()),
        (torch.cuda, "Event", Event),
        (torch.cuda, "_sleep", lambda cycles: None),
        (torch, "randn", torch.randn),
    ):
        monkeypatch.setattr(module, name, noted(name, function))
    monkeypatch.setattr(nvidia_checks, "_BUSY", 4)
    return asked


@pytest.fixture
def backend(monkeypatch):
    return backend_on(FakeCuda(Backend(choose_device()).context), monkeypatch)


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(nvidia_checks, "CASES", ((3, 60),))
    monkeypatch.setattr(nvidia_checks, "large_scene", lambda count, dtype: make_scene(300, 16, 130, 90, dtype=dtype))
    monkeypatch.setattr(nvidia_checks, "RUNS", 2)
    monkeypatch.setattr(nvidia_training, "WHOLE", SMALL)
    monkeypatch.setattr(nvidia_training, "OURS", replace(SMALL, kernel_size=1))
    monkeypatch.setattr(nvidia_timing, "REPETITIONS", 1)


def few_inputs():
    scene = make_scene(dtype=torch.float32)
    return Inputs(*scene.gaussians, views=(View(*scene.camera),))


def gsplat_on_the_cpu():
    """The part of gsplat that is called, with gsplat's own parameter names."""
    gsplat = pytest.importorskip("gsplat")
    signature = inspect.signature(gsplat.rasterization)

    def rasterization(*given, **options):
        given = signature.bind(*given, **options).arguments
        color = given["colors"].mean(dim=0) + given["opacities"].mean()
        picture = color.expand(*given["viewmats"].shape[:1], given["height"], given["width"], -1)
        return picture, picture[..., :1], {}

    return SimpleNamespace(rasterization=rasterization, __version__="1.0")


@pytest.mark.usefixtures("queued", "small")
def test_a_gsplat_that_cannot_be_compiled_is_no_failure_of_ours(monkeypatch, capsys):
    def rasterization(*given, **options):
        raise RuntimeError("no nvcc")

    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=rasterization))
    nvidia_timing.time_workload(CPU, few_inputs())
    printed = capsys.readouterr().out
    assert "RuntimeError('no nvcc')" in printed
    assert "  ours " in printed


@pytest.mark.usefixtures("queued", "small")
@pytest.mark.slow  # test_nvidia_checks.py has them one by one
def test_all_checks_hold_where_the_cpu_stands_in_for_the_gpu(backend, monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, "gsplat", gsplat_on_the_cpu())
    monkeypatch.setattr(nvidia, "gpu_backend", lambda: backend)
    monkeypatch.setattr(type(box_named("B")), "inputs", lambda box: few_inputs())
    monkeypatch.setattr("opencl.bench.workloads.BOXES", (box_named("B"), Box("paper", 60, 40, 30)))
    monkeypatch.setattr(nvidia, "LARGE", ("paper",))
    assert nvidia.main(["--ptx", str(tmp_path / "ptx")]) == 0
    printed = capsys.readouterr().out
    assert "all checks hold" in printed
    assert printed.count("holds: torch.float32, lists") == 2
    for line in ("holds: bfloat16, a training that goes on", "gsplat 1.0", "pictures:", "CPU tensors, copied"):
        assert line in printed
    assert printed.count("\n  blend_backward ") == 2
    for line in ("decoders, float32", "decoders, tf32", "decoders, bfloat16", "similarities  "):
        assert f"\n  {line}" in printed
    written = sorted(path.name for path in (tmp_path / "ptx").iterdir())
    for beginning in ("blending-float32-M3-", "geometry-float64-", "harmonics-float32-", "ssim-float64-"):
        assert any(name.startswith(beginning) and name.endswith(".ptx") for name in written), written
    assert ".entry blend(" in (tmp_path / "ptx" / written[0]).read_text()


def test_an_exception_fails_its_check_and_the_others_go_on(capsys):
    def broken():
        raise RuntimeError("cuModuleLoadDataEx: no such thing")

    named = [("first", broken), ("second", lambda: True), ("third", lambda: False), ("fourth", lambda: None)]
    assert nvidia.failing(iter(named)) == ["first", "third"]
    printed = capsys.readouterr().out
    assert 'raise RuntimeError("cuModuleLoadDataEx' in printed
    assert "RuntimeError: cuModuleLoadDataEx: no such thing" in printed


def test_a_failing_check_is_the_exit_status(monkeypatch, capsys):
    monkeypatch.setattr(nvidia, "gpu_backend", lambda: "a backend")
    monkeypatch.setattr(nvidia, "checks", lambda backend, inputs: iter([("pictures", lambda: False)]))
    assert nvidia.main([]) == 1
    assert capsys.readouterr().out.endswith("FAILS: pictures\n")


@pytest.mark.usefixtures("small")
def test_ptx_is_written_though_the_driver_refuses_it(backend, tmp_path):
    compiled = backend._compile
    backend._compile = lambda program: compiled(program).replace(b"ret;", b"refused;")
    nvidia.write_ptx(backend, tmp_path)
    assert nvidia.failing(iter([("similarities", lambda: nvidia_checks.check_similarities(backend))]))
    (path,) = tmp_path.iterdir()
    assert path.name.startswith("ssim-float64-M1-")
    assert "refused;" in path.read_text()


def test_without_a_gpu(capsys):
    if torch.cuda.is_available():
        pytest.skip("there is one")
    assert nvidia.main([]) == 2
    assert "torch sees no CUDA device" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("where", "drawn_by_cpu", "zero_copy", "said"),
    [
        ("cuda", True, True, None),
        ("cpu", True, True, "GS_HIDER_DEVICE names portable, which is not torch's CUDA device: unset it"),
        ("cuda", False, True, "nothing to compare with: CPU tensors would be drawn by a device"),
        ("cuda", True, False, "CUDA tensors would be drawn by a device, with copies: see what is missing above"),
    ],
)
def test_the_gpu_is_reached_or_it_is_said_why_not(where, drawn_by_cpu, zero_copy, said, backend, monkeypatch, capsys):
    described = SimpleNamespace(is_cpu=drawn_by_cpu, describe=lambda: "a device")
    other = SimpleNamespace(device=described)
    monkeypatch.setenv("GS_HIDER_DEVICE", "portable")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "a GPU")
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda: (9, 0))
    monkeypatch.setattr(opencl.__main__, "main", lambda arguments: 0)
    monkeypatch.setattr(opencl.backend, "default_backend", lambda: other)
    monkeypatch.setattr(opencl.routes, "working_device", lambda: torch.device(where))
    monkeypatch.setattr(opencl.routes, "backend_for", lambda device: backend if zero_copy else other)
    assert nvidia.gpu_backend() is (backend if said is None else None)
    assert (said or "a GPU") in capsys.readouterr().out


@pytest.mark.parametrize(("package", "status"), [("pydantic", 0), ("jaxtyping", 2)])
def test_what_is_not_installed_is_named(package, status, monkeypatch, capsys):
    find_spec = nvidia.importlib.util.find_spec
    monkeypatch.setattr(nvidia.importlib.util, "find_spec", lambda name: None if name == package else find_spec(name))
    monkeypatch.setattr(nvidia, "gpu_backend", lambda: "a backend")
    monkeypatch.setattr(nvidia, "checks", lambda backend, inputs: iter(()))
    assert nvidia.main([]) == status
    assert f"not installed: pip install {package}\n" in capsys.readouterr().out


def test_nothing_else_that_the_project_depends_on_is_needed():
    others = "dask distributed cryptography zarr numcodecs pycolmap cv2 PIL plyfile safetensors ruamel.yaml typer rich"
    code = f"""
import sys
sys.modules.update(dict.fromkeys({[*others.split(), "pytest", "hypothesis"]!r}))
import torch
from tests.benchmarks import nvidia, nvidia_checks, nvidia_timing, nvidia_training
nvidia_training.prepared(torch.device("cpu"), "bfloat16", nvidia_training.{SMALL!r}).step(1)
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_streams_read_nothing_that_is_still_being_made(queued):
    nvidia_checks.check_streams(CPU)
    assert queued.index("randn") < queued.index("synchronize") < queued.index("Stream")


def test_a_training_that_forgets_something_fails(monkeypatch, capsys):
    def forget(training, state):
        set_state(training, state)
        training.optimizer.adam.state.clear()

    set_state = nvidia_training.set_state
    monkeypatch.setattr(nvidia_training, "set_state", forget)
    assert not check_training(CPU, "float32", SMALL)
    assert "FAILS: float32, a training that goes on from iteration 43: other " in capsys.readouterr().out


def test_a_training_that_begins_otherwise_fails(monkeypatch):
    turns = iter((1.0, 1.1))

    def other(*arguments):
        made = prepared(*arguments)
        step, factor = made.step, next(turns)
        made.step = lambda iteration: {name: factor * value for name, value in step(iteration).items()}
        return made

    monkeypatch.setattr(nvidia_training, "prepared", other)
    assert not nvidia_training.check_first_figures(CPU, "float32", SMALL)


def test_the_training_has_gaussians_that_are_refined():
    training, counts = prepared(CPU, "float32", SMALL), set()
    training.run(lambda: counts.add(len(training.gaussians)))
    assert len(counts) > 1
    assert min(counts) > 0
