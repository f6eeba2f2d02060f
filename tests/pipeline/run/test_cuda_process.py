"""What a stage leaves on a GPU. There is none here, so torch is told what CUDA would do."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from importlib import import_module
from types import SimpleNamespace

import pytest
import torch

from pipeline.run.cluster import DaskExecutor
from pipeline.run.cuda_process import _HOLDERS, cuda_is_broken, return_gpu_memory
from pipeline.run.executor import Lost, Tell


def fail() -> None:
    raise RuntimeError("CUDA error: an illegal memory access was encountered")


@pytest.fixture
def returned(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """An entry for each time that memory was given back, with a CUDA that works."""
    times: list[str] = []
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: None)
    monkeypatch.setattr(torch.cuda, "empty_cache", lambda: times.append("returned"))
    return times


def test_what_is_free_is_given_back(returned: list[str]) -> None:
    return_gpu_memory()
    assert returned == ["returned"]
    assert not cuda_is_broken()


def test_what_our_own_copies_leave_is_given_back(returned: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Even if torch has not used CUDA, since OpenCL keeps buffers on the GPU."""
    holder = SimpleNamespace(return_held_memory=lambda: returned.append("ours"))
    monkeypatch.setitem(sys.modules, "opencl.staging", holder)
    return_gpu_memory()
    assert returned == ["returned", "ours"]
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: False)
    return_gpu_memory()
    assert returned == ["returned", "ours", "ours"]


def test_our_own_say_how() -> None:
    return_gpu_memory()  # of modules that may not be loaded
    assert all(callable(import_module(name).return_held_memory) for name in _HOLDERS)
    return_gpu_memory()


def test_nothing_is_asked_of_a_cuda_that_is_broken(returned: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """It would only fail again, and hide the stage's own error."""
    monkeypatch.setattr(torch.cuda, "synchronize", fail)
    assert cuda_is_broken()
    return_gpu_memory()
    assert returned == []


@pytest.mark.parametrize("lacks", ["torch", "cuda"])
def test_nothing_is_started_for_it(returned: list[str], monkeypatch: pytest.MonkeyPatch, lacks: str) -> None:
    if lacks == "torch":
        monkeypatch.delitem(sys.modules, "torch")
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: False)
    return_gpu_memory()
    assert not cuda_is_broken()
    assert returned == []


def break_cuda(subject: object, tell: Tell) -> int:
    """Work whose kernel reads where it must not."""
    import torch as started

    started.cuda.is_initialized = lambda: True
    started.cuda.synchronize = fail
    return os.getpid()


def process(subject: object, tell: Tell) -> int:
    return os.getpid()


@pytest.fixture
def executor() -> Iterator[DaskExecutor]:
    executor = DaskExecutor(1)
    yield executor
    executor.close()


def done(executor: DaskExecutor, work: object) -> int | Lost:
    executor.start("work", work, None, 0, {})
    while (ended := executor.wait(lambda event: None, 1.0)) is None:
        pass
    return ended[1]


def test_a_process_in_which_cuda_is_broken_does_no_more_work(executor: DaskExecutor) -> None:
    """The next work is lost before it begins, so the engine tries it again, and it works in another process."""
    broken = done(executor, break_cuda)
    lost = done(executor, process)
    assert isinstance(lost, Lost)
    assert lost.transient
    while isinstance(other := done(executor, process), Lost):
        time.sleep(0.5)  # until there is another process
    assert other != broken
