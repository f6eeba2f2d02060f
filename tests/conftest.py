"""What holds for all tests: Hypothesis draws the same examples on every run, Ctrl-C interrupts, and the CPU is tested.

What is green stays green until the code changes.

To search for new ones: `pytest --hypothesis-profile=search tests/opencl/test_poison.py`.
"""

from __future__ import annotations

import os
import signal

import pytest
from hypothesis import settings

settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search", derandomize=False)
settings.load_profile("repeatable")

# Whoever starts the tests in the background of a script has them ignore SIGINT, and all that they start in turn.
signal.signal(signal.SIGINT, signal.default_int_handler)

# A machine's NVIDIA GPU has checks of its own (tests.benchmarks.nvidia); runs that tests start would ask for it.
os.environ.setdefault("CUDA_VISIBLE_DEVICES", "")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whole workflows first: of files that take minutes, the last ones would leave all workers but one without work."""
    items.sort(key=lambda item: "workflows" not in item.path.parts)
