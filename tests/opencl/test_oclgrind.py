"""Small jobs under Oclgrind: no race, no access out of bounds, no uninitialised value, no misuse of OpenCL."""

from __future__ import annotations

import re

import pytest

from tests.opencl.oclgrind_job import BROKEN
from tests.opencl.runtimes import OCLGRIND, SCHEDULES, oclgrind_environment, run_module

# Private memory can be tracked only without optimisation: Oclgrind does not know `freeze`, which LLVM inserts.
FOLLOW_UNINITIALISED = {"OCLGRIND_UNINITIALIZED": "1", "OCLGRIND_BUILD_OPTIONS": "-cl-opt-disable"}
# Oclgrind also misinterprets the scalar projection once LLVM has vectorised it: gradients differ from PoCL's, from the
# reference's, and from its own without optimisation.
AS_WRITTEN = {"OCLGRIND_BUILD_OPTIONS": "-cl-opt-disable"}
BROKEN_REPORTS = {
    "write_out_of_bounds": "Invalid write",
    "read_out_of_bounds": "Invalid read",
    "missing_barrier": "data race",
    "work_groups_write_the_same": "data race",
    "uninitialised_private": "Controlflow depends on uninitialized value",
    "uninitialised_local": "Controlflow depends on uninitialized value",
}


@pytest.fixture
def oclgrind(tmp_path):
    """A function that runs a job under Oclgrind and returns what it printed, and Oclgrind's reports."""
    environment = oclgrind_environment(tmp_path)
    if environment is None:
        pytest.skip(f"Oclgrind is not in {OCLGRIND}: `make test` installs it on Linux on x86-64")

    def run(*arguments, **options):
        log = tmp_path / "log"
        checks = {"OCLGRIND_DATA_RACES": "1", "OCLGRIND_UNIFORM_WRITES": "1", "OCLGRIND_CHECK_API": "1"}
        done = run_module(
            environment | checks | {"OCLGRIND_LOG": str(log)} | options, "tests.opencl.oclgrind_job", *arguments
        )
        assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
        return done.stdout, _reports(log.read_text() if log.exists() else "")

    return run


def _reports(log):
    """All reports but those about pyopencl's queries of devices, which include properties of newer OpenCL versions."""
    reports = [report.strip() for report in re.split(r"\n\s*\n(?=\S)", log) if report.strip()]
    return [report for report in reports if "Function: clGetDeviceInfo" not in report]


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize(
    ("feature_dim", "dtype"),
    [(3, "float32"), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((17, "float32"), (3, "float64")))],
)
def test_no_race_and_nothing_out_of_bounds(oclgrind, schedule, feature_dim, dtype):
    """On the GPU schedule in float32, also no uninitialised value.

    Oclgrind 21.10 crashes when it tracks uninitialised values through shuffles of 16 lanes with unused places.
    `test_scratch.py` checks that the CPU schedule does not depend on memory that it has not written.
    """
    options = {}
    if schedule == "gpu":
        options = FOLLOW_UNINITIALISED if dtype == "float32" else AS_WRITTEN
    printed, reports = oclgrind("draw", schedule, str(feature_dim), dtype, **options)
    assert reports == []
    assert float(printed) < (1e-4 if dtype == "float32" else 1e-9)


@pytest.mark.parametrize("schedule", ["cpu", pytest.param("gpu", marks=pytest.mark.slow)])
def test_batches_that_follow_each_other(oclgrind, schedule):
    printed, reports = oclgrind("crowd", schedule, **(AS_WRITTEN if schedule == "gpu" else {}))
    assert reports == []
    assert float(printed) < 1e-4


@pytest.mark.parametrize("schedule", ["gpu", pytest.param("cpu", marks=pytest.mark.slow)])
@pytest.mark.parametrize("job", ["compare", "color"])
def test_similarities_and_harmonics(oclgrind, job, schedule):
    printed, reports = oclgrind(job, schedule, **(AS_WRITTEN if schedule == "gpu" else {}))
    assert reports == []
    assert float(printed) < 1e-10


@pytest.mark.parametrize("job", ["convolve", "decode_pixels", "separate"])
def test_what_only_cpus_do(oclgrind, job):
    printed, reports = oclgrind(job)
    assert reports == []
    assert float(printed) < 1e-10


def test_broken_kernels_are_reported_and_a_correct_one_is_not(oclgrind):
    printed, reports = oclgrind("broken", **FOLLOW_UNINITIALISED)
    assert printed.split() == list(BROKEN)
    for name, expected in BROKEN_REPORTS.items():
        assert any(expected in report and f"Kernel: {name}" in report for report in reports), name
    assert not [report for report in reports if "Kernel: correct" in report]
