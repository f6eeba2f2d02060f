"""Freed memory is kept while a stage works, and given back when it has ended."""

from __future__ import annotations

import platform
import resource
import subprocess
import sys

import pytest

from pipeline.run.cluster import DaskExecutor
from pipeline.run.executor import Tell

PIECES = """
import resource, sys, threading
from pipeline.run.freed_memory import keep_freed_memory, return_freed_memory

def held():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()

def work():
    for _ in range(50):
        pieces = [bytearray(8 << 20) for _ in range(4)]

def measure():
    work()
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
    work()
    faults.append(resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before)

faults = []
if sys.argv[1] == "kept":
    keep_freed_memory()
if sys.argv[2] == "thread":
    thread = threading.Thread(target=measure)
    thread.start()
    thread.join()
else:
    measure()
full = held()
return_freed_memory()
print(faults[0], full - held())
"""


def _page_faults(kept: str, where: str) -> tuple[int, int]:
    """Page faults for two hundred pieces of 8 MiB, four at a time, and how many bytes are then given back."""
    command = [sys.executable, "-c", PIECES, kept, where]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    faults, returned = map(int, done.stdout.split())
    return faults, returned


def page_faults_at_work(subject: object, tell: Tell) -> int:
    """The page faults for such pieces, as the work of an executor."""
    faults = 0
    for _ in range(2):  # the second time, freed memory can be reused
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
        for _ in range(50):
            _ = [bytearray(8 << 20) for _ in range(4)]
        faults = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before
    return faults


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other allocators are left as they are")
@pytest.mark.parametrize("where", ["thread", "main"])
def test_pieces_are_kept_while_working_and_given_back_afterwards(where: str) -> None:
    """Also in a thread, in which the workers work."""
    without, _ = _page_faults("as it is", where)
    faults, returned = _page_faults("kept", where)
    assert faults < without / 20
    assert returned > 24 << 20


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other allocators are left as they are")
def test_workers_keep_it() -> None:
    without, _ = _page_faults("as it is", "thread")
    executor = DaskExecutor(1)
    try:
        executor.start("work", page_faults_at_work, None, 0, {})
        ended = None
        while ended is None:
            ended = executor.wait(lambda event: None, 1.0)
    finally:
        executor.close()
    name, faults = ended
    assert name == "work"
    assert faults < without / 20
