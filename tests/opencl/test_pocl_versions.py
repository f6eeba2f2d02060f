"""Pictures, gradients and determinism on the PoCL that is not this machine's default: PyPI's wheel or Debian's package.

Each compiles kernels with its own LLVM, for a different instruction set. A separate process loads the other one and
runs a file of tests on it, without those that take long and do not depend on the compiler: finite differences, which
draw hundreds of pictures (gradients are compared with the reference's as well), and processes with one and two threads.
"""

from __future__ import annotations

import os
import re

import pytest

from opencl.device import DEVICE_VARIABLE, choose_device
from tests.opencl.runtimes import DEBIAN_POCL, debian_pocl_environment, run_module

LISTED = re.compile(r"^[* ] (\d+:\d+)  Portable Computing Language \((.*?)\): ", re.MULTILINE)


@pytest.fixture
def other_pocl(tmp_path):
    """An environment in which GS_HIDER_DEVICE names a PoCL of another version than the default device's."""
    environment = debian_pocl_environment(tmp_path) or dict(os.environ)
    environment.pop("POCL_CACHE_DIR", None)  # belongs to this process alone
    environment.pop(DEVICE_VARIABLE, None)
    listed = run_module(environment, "opencl", "devices").stdout
    others = [index for index, version in LISTED.findall(listed) if version not in choose_device().name]
    if not others:
        pytest.skip(
            f"no second PoCL: `make test` unpacks Debian's in {DEBIAN_POCL} where apt reaches it; found only: {listed}"
        )
    return environment | {DEVICE_VARIABLE: others[0]}


@pytest.mark.parametrize(
    ("name", "without"),
    [
        pytest.param("test_rasterizer", "gpu", marks=pytest.mark.slow),  # only tests run GPU kernels on a CPU
        ("test_pixel_decoder", "threads"),
        ("test_separation", "threads"),
        pytest.param("test_convolution", "threads", marks=pytest.mark.slow),
        pytest.param("test_gradients", "gradcheck", marks=pytest.mark.slow),
        pytest.param("test_determinism", "", marks=pytest.mark.slow),
        pytest.param("test_shapes", "", marks=pytest.mark.slow),
    ],
)
def test_the_same_tests_on_the_other_pocl(other_pocl, name, without):
    options = ["-q", "-p", "no:cacheprovider", "-o", "addopts=-m 'not slow'", "-k", f"not {without}" if without else ""]
    done = run_module(other_pocl, "pytest", *options, f"tests/opencl/{name}.py")
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
