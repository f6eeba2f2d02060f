"""Stages keep their tensors on the device they work on: tested on a pretended GPU, which needs no real one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from opencl.device import DEVICE_VARIABLE
from tests.pretended_gpu import available

CHECKS = Path(__file__).with_name("pretended_gpu_checks.py")


@pytest.mark.skipif(not available, reason="this torch can be told of no device that is written in Python")
@pytest.mark.parametrize("which", ["not slow", pytest.param("slow", marks=pytest.mark.slow)])
def test_stages_make_the_bits_of_the_cpu(which: str) -> None:
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "-m",
        which,
        str(CHECKS),
    ]
    environment = {**os.environ, DEVICE_VARIABLE: "portable computing", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, cwd=CHECKS.parents[2], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
