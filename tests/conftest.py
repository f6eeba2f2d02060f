"""Setup of all tests: Hypothesis draws the same examples on every run, Ctrl-C interrupts, and the CPU is tested.

A test that passes therefore keeps passing until the code changes, also on a busy machine: no example has a deadline.

To search for new examples: `pytest --hypothesis-profile=search tests/opencl/test_poison.py`.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import jaxtyping
import pytest
from hypothesis import settings

from tests.array_types import arrays_are_checked, arrays_checked

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("search", derandomize=False, deadline=None)
settings.load_profile("repeatable")

# Tests that a script starts in the background would ignore SIGINT, and so would all processes that they start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Runs that tests start would ask for the machine's NVIDIA GPU, which has its own checks (tests.benchmarks.nvidia).
# (A cluster's scheduler may have set the variable.)
os.environ["CUDA_VISIBLE_DEVICES"] = ""


# Before anything imports these two packages. It doubles the time of tests that compute.
if arrays_are_checked():
    jaxtyping.install_import_hook(["opencl", "stages"], f"{arrays_checked.__module__}.{arrays_checked.__name__}")


@pytest.fixture
def any_arrays() -> Iterator[None]:
    """For tests of what functions themselves say of wrong arrays: these are let through."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run whole workflows first: if files that take minutes came last, all workers but one would be idle."""
    items.sort(key=lambda item: "workflows" not in item.path.parts)
