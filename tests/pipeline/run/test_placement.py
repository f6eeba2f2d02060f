"""Resources: how they are written, what fits together, and what a machine or cluster cannot do at all."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from pipeline import resources
from pipeline.errors import UserError
from pipeline.resources import amount, memory_of_machine, of_this_machine, read_resources
from pipeline.run.placement import Worker, lacking, place
from pipeline.stage import Context, Parameters, stage
from tests.pipeline.helpers import Workspace

GIB = 2.0**30
HERE = [Worker("one", {"memory": 8 * GIB}, shared=True), Worker("two", {"memory": 8 * GIB}, shared=True)]
CLUSTER = [Worker("small", {"memory": 8 * GIB}), Worker("large", {"memory": 64 * GIB, "gpu": 2.0})]


@pytest.mark.parametrize(
    ("name", "value"),
    [("memory", "8 bananas"), ("memory", "-1"), ("gpu", "1 GiB"), ("gpu", True), ("gpu", None), ("g p u", 1)],
)
def test_wrong_amounts(name: str, value: object) -> None:
    with pytest.raises(UserError):
        amount(name, value)


def test_amounts_are_bytes_and_numbers() -> None:
    assert read_resources("gpu=2,memory=1.5GiB disk=1e3") == {"gpu": 2.0, "memory": 1.5 * GIB, "disk": 1000.0}
    assert amount("memory", "16 GB") == 16e9
    assert read_resources("") == {}
    with pytest.raises(UserError, match=r"expected NAME=AMOUNT, such as gpu=1"):
        read_resources("gpu")


def test_this_machine_has_its_memory_or_its_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resources, "CONTROL_GROUPS", tmp_path)
    whole = memory_of_machine()
    assert whole is not None
    (tmp_path / "memory.max").write_text("max\n")
    assert memory_of_machine() == whole
    (tmp_path / "memory.max").write_text("1000000\n")
    assert memory_of_machine() == 1e6
    assert of_this_machine({"gpu": 1.0}) == {"memory": 1e6, "gpu": 1.0}
    assert of_this_machine({"memory": 5.0}) == {"memory": 5.0}, "who states it knows better"


def test_only_what_fits_together_runs_together() -> None:
    large, small = {"memory": 5 * GIB}, {"memory": 3 * GIB}
    assert place(large, HERE, {"one": large}) is None, "they share this machine's memory"
    assert place(small, HERE, {"one": large}) == HERE[1]
    assert place(large, CLUSTER, {"small": large}) == CLUSTER[1], "workers of a cluster share nothing"
    assert place({}, HERE, {"one": {}, "two": {}}) is None, "one piece a worker"


def test_what_a_run_was_not_told_of_is_given_to_one_stage_at_a_time() -> None:
    wanted = {"gpu": 1.0}
    assert place(wanted, HERE, {}) == HERE[0]
    assert place(wanted, HERE, {"one": wanted}) is None
    assert place({}, HERE, {"one": wanted}) == HERE[1]
    told = [Worker(worker.address, {"gpu": 0.0}, shared=True) for worker in HERE]
    assert lacking(wanted, told) == "needs gpu 1, but this machine has gpu 0"


def test_workers_of_a_cluster_have_what_they_say() -> None:
    assert place({"gpu": 2.0}, CLUSTER, {}) == CLUSTER[1]
    assert lacking({"gpu": 2.0}, CLUSTER) is None
    assert lacking({"gpu": 3.0}, CLUSTER) == (
        "needs gpu 3, which no worker has (small has memory 8 GiB; large has memory 64 GiB and gpu 2)"
    )
    assert lacking({}, []) == "needs a worker, but there is no worker"
    assert lacking({"memory": 1e15}, [Worker("unlimited", {"memory": math.inf})]) is None


def test_a_workflow_overrides_what_a_stage_declares(workspace: Workspace) -> None:
    workspace.write("""
        vars: {big: 16GiB}
        stages:
          a: {uses: numbers, resources: {memory: "${big}", gpu: 1}}
        """)
    assert workspace.open().graph.nodes["a"].resources == {"memory": 16 * GIB, "gpu": 1.0}
    workspace.write(
        "stages:\n  a: {uses: numbers, resources: {memory: much, gpu: [1]}}\n  b: {uses: numbers, resources: 3}\n"
    )
    assert workspace.problems() == [
        "2:42: resource 'memory' has an invalid amount; found 'much'; expected bytes, or a text such as 8 GiB",
        "2:53: resource 'gpu' has an invalid amount; found [1]; expected a number that is not negative",
        "3:33: 'resources' of stage 'b' is the number 3; expected a mapping",
    ]


def test_a_stage_declares_amounts() -> None:
    def work(context: Context, parameters: Parameters) -> None: ...

    declared = stage(inputs={}, outputs={}, version=1, resources={"gpu": 1, "memory": "8 GiB"})(work)
    assert declared.resources == {"gpu": 1.0, "memory": 8 * GIB}
    with pytest.raises(TypeError, match="stage work: resource 'memory' has an invalid amount"):
        stage(inputs={}, outputs={}, version=1, resources={"memory": "much"})(work)
