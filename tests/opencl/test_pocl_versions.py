"""Pictures, gradients and determinism on the PoCL that is not this machine's default: PyPI's wheel or Debian's package.

Each compiles kernels with an LLVM of its own, for another instruction set. Another process loads the other one and runs
these tests' files on it.
"""

from __future__ import annotations

import pytest

from opencl.device import DEVICE_VARIABLE, choose_device
from tests.opencl.runtimes import DEBIAN_POCL, debian_pocl_environment, run_module

POCL_VERSIONS = {"PyPI's wheel": "PoCL 3.0-rc2", "Debian's package": "PoCL 3.1"}
FILES = ("test_rasterizer", "test_gradients", "test_determinism", "test_shapes")


@pytest.fixture(params=POCL_VERSIONS)
def pocl_environment(request, tmp_path):
    """Where `GS_HIDER_DEVICE` names the version, which is not the default."""
    version = POCL_VERSIONS[request.param]
    if version in choose_device().name:
        pytest.skip(f"{version} is the device of all the other tests already")
    environment = debian_pocl_environment(tmp_path)
    if environment is None:
        pytest.skip(f"{version} is not in {DEBIAN_POCL}: `make test` unpacks it there, where apt reaches its packages")
    environment[DEVICE_VARIABLE] = version
    environment.pop("POCL_CACHE_DIR", None)  # of this process alone
    listed = run_module(environment, "opencl", "devices")
    if listed.returncode != 0:
        pytest.skip(f"there is no {version} among: {listed.stderr}")
    assert any(line.startswith("*") and version in line for line in listed.stdout.splitlines()), listed.stdout
    return environment


@pytest.mark.parametrize("file", FILES)
def test_on_the_other_pocl(pocl_environment, file):
    done = run_module(pocl_environment, "pytest", "-q", "-p", "no:cacheprovider", f"tests/opencl/{file}.py")
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    assert " passed" in done.stdout or "[100%]" in done.stdout
