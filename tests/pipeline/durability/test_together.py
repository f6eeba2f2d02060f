"""Several runs at once on one store, some of them killed: each action is done once, and all end well."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from pipeline.store.store import Store
from tests.pipeline.durability import commands
from tests.pipeline.durability.commands import TOYS
from tests.pipeline.helpers import Workspace

WORKFLOW = """
    name: together
    stages:
      first: {uses: grow, with: {seed: 50, steps: 4}}
      each:
        foreach: {seed: [SEEDS]}
        uses: grow
        in: {numbers: first}
        with: {seed: "${item.seed}", steps: 4}
      all:   {uses: gather, in: {numbers: each}, with: {seed: -1}}
    """


class Several:
    """Runs of overlapping workflows on one store, each workflow in a folder of its own."""

    def __init__(self, folder: Path, seeds: list[str]) -> None:
        self.workspaces = []
        for number, listed in enumerate(seeds):
            own = folder / f"run-{number}"
            own.mkdir()
            self.workspaces.append(Workspace(own, TOYS).write(WORKFLOW.replace("SEEDS", listed)))
        self.store = Store(folder / "store")

    def start(self, *flags: str) -> list[commands.Running]:
        return [commands.start(workspace, *flags, store="../store") for workspace in self.workspaces]

    def count(self, what: str) -> Counter[tuple[str, ...]]:
        """How often each stage reported that it did `what`."""
        lines = [line for workspace in self.workspaces for line in commands.lines_told(workspace)]
        return Counter(tuple(line) for line in lines if line[0] == what)

    def printed(self) -> str:
        return "".join((workspace.folder / "printed.txt").read_text() for workspace in self.workspaces)


@pytest.mark.parametrize(
    ("seeds", "flags"),
    [
        pytest.param(["0, 1, 2, 3"] * 2, ["--serial"], marks=pytest.mark.slow),
        (["0, 1, 2", "1, 2, 3", "2, 3, 0", "0, 1, 2, 3"], ["--serial"]),
        pytest.param(["0, 1, 2, 3", "2, 3, 4, 5"], ["--workers", "2"], marks=pytest.mark.slow),
    ],
)
def test_each_action_is_done_once(tmp_path: Path, seeds: list[str], flags: list[str]) -> None:
    several = Several(tmp_path, seeds)
    processes = several.start(*flags)
    assert [process.wait(commands.LONGEST) for process in processes] == [0] * len(processes), several.printed()
    grown = {line: number for line, number in several.count("end").items() if line[1] != "-1"}
    expected = {("end", "50"), *(("end", seed) for listed in seeds for seed in listed.split(", "))}
    assert grown == dict.fromkeys(expected, 1)
    assert sum(several.count("end").values()) - len(expected) == len(set(seeds)), "one sum for each choice of seeds"
    commands.check_whole(several.store)


@pytest.mark.parametrize("flags", [["--serial"], pytest.param(["--workers", "2"], marks=pytest.mark.slow)])
def test_while_others_are_killed(tmp_path: Path, flags: list[str]) -> None:
    """The survivor finishes what the killed runs had begun, from their checkpoints; no step is repeated."""
    several = Several(tmp_path, ["0, 1, 2, 3"] * 3)
    first, second, third = several.start(*flags)
    for process, moment in ((first, 3), (second, 8)):
        commands.await_that(
            lambda moment=moment: sum(several.count("step").values()) >= moment or third.poll() is not None, "steps"
        )
        commands.kill(process.pid)
        process.wait(commands.LONGEST)
    assert third.wait(commands.LONGEST) == 0, several.printed()
    assert set(several.count("step").values()) == {1}
    later = commands.start(several.workspaces[0], "--serial", store="../store")
    assert later.wait(commands.LONGEST) == 0
    commands.check_whole(several.store)
    assert len(list(several.store.root.glob("temporary/*"))) <= 2, "a later run removes what the killed were writing"


def test_two_runs_repair_one_artifact(tmp_path: Path) -> None:
    """Neither removes what the other has just remade."""
    several = Several(tmp_path, ["0, 1, 2, 3"])
    (process,) = several.start("--serial")
    assert process.wait(commands.LONGEST) == 0
    record = next(
        record
        for record in (several.store.record(key) for key in several.store.actions)
        if record and dict(record.parts)["parameters"]["seed"] == 50
    )
    chunk = several.store.object(record.outputs["numbers"]) / "arrays.zarr/values0/c/0"
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"?")
    again = [
        commands.start(several.workspaces[0], "--serial", "--set", f"each.size={size}", store="../store")
        for size in (999, 998)
    ]
    assert [process.wait(commands.LONGEST) for process in again] == [0, 0], several.printed()
    assert several.count("end")["end", "50"] == 2, "made once, and made again once"
    commands.check_whole(several.store)
