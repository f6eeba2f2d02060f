"""kill -9 at random moments, of the parent, a worker or everything at once: finished work stays finished."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from pipeline.store.store import Store
from tests.pipeline.durability import commands
from tests.pipeline.durability.commands import TOYS
from tests.pipeline.helpers import Workspace

SEEDS = range(6)
WORKFLOW = f"""
    name: fan
    stages:
      first: {{uses: grow, with: {{seed: 100}}}}
      each:
        foreach: {{seed: [{", ".join(map(str, SEEDS))}]}}
        uses: grow
        in: {{numbers: first}}
        with: {{seed: "${{item.seed}}"}}
      all:   {{uses: gather, in: {{numbers: each}}}}
      last:  {{uses: grow, in: {{numbers: all}}, with: {{seed: 200}}}}
    """
STAGES = len(SEEDS) + 3
VICTIMS = ("parent", "worker", "group")


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Digests of what an undisturbed run makes."""
    workspace = Workspace(tmp_path_factory.mktemp("undisturbed"), TOYS).write(WORKFLOW)
    return digests(workspace)


def digests(workspace: Workspace) -> dict[str, str]:
    ran = workspace.run()
    assert ran.summary.counts.get("failed", 0) == 0
    return {name: event.outputs["numbers"].name for name, event in ran.ended.items()}


class Destroyer:
    """Runs a workflow again and again, and kills each run after it has reported some number of lines."""

    def __init__(self, folder: Path, flags: list[str], seed: int) -> None:
        self.folder = folder
        self.flags = flags
        self.chance = random.Random(seed)
        self.number = 0
        self.begin_anew()

    def begin_anew(self) -> None:
        self.number += 1
        folder = self.folder / str(self.number)
        folder.mkdir()
        self.workspace = Workspace(folder, TOYS).write(WORKFLOW)

    @property
    def store(self) -> Store:
        return Store(self.workspace.folder / "store")

    def kill_once(self, victim: str) -> bool:
        """Starts a run and kills the victim at a random moment. Returns False if the run succeeds nonetheless."""
        before = commands.finished(self.store)
        said = len(commands.lines_told(self.workspace))
        moment = said + self.chance.randrange(1, 25)
        process = commands.start(self.workspace, *self.flags)
        commands.await_that(
            lambda: process.poll() is not None or len(commands.lines_told(self.workspace)) >= moment, "the moment"
        )
        if process.poll() is None:
            self._kill(process, victim)
        everyone = commands.descendants(process.pid)
        status = process.wait(commands.LONGEST)
        commands.await_that(lambda: not any(map(commands.is_alive, everyone)), "workers to end with their parent")
        after = commands.finished(self.store)
        assert before.items() <= after.items(), "finished work was touched"
        return status != 0

    def _kill(self, process: commands.Running, victim: str) -> None:
        workers = commands.workers_of(process.pid)
        everyone = commands.descendants(process.pid)
        if victim == "worker" and workers:
            commands.kill(self.chance.choice(workers))
            return
        commands.kill(process.pid, group=victim == "group")
        process.wait(commands.LONGEST)
        commands.await_that(lambda: not any(map(commands.is_alive, everyone)), "workers to end with their parent")

    def finish(self, expected: dict[str, str]) -> None:
        """Runs to the end, undisturbed: the result is that of a run without interruptions."""
        status, printed = commands.call(self.workspace, "--serial")
        assert (status, "Traceback" in printed) == (0, False), printed
        commands.check_whole(self.store)
        assert digests(self.workspace) == expected
        assert self.repeated_steps() == 0

    def repeated_steps(self) -> int:
        """How many steps were repeated although a checkpoint of them existed."""
        steps = [tuple(line) for line in commands.lines_told(self.workspace) if line[0] == "step"]
        return len(steps) - len(set(steps))


def destroy(folder: Path, flags: list[str], victims: list[str], expected: dict[str, str], seed: int) -> None:
    destroyer = Destroyer(folder, flags, seed)
    for victim in victims:
        while not destroyer.kill_once(victim):
            destroyer.finish(expected)
            destroyer.begin_anew()
    destroyer.finish(expected)


def test_six_kills(tmp_path: Path, expected: dict[str, str]) -> None:
    for name, flags, victims in (
        ("serial", ["--serial"], ["parent"] * 4),
        ("workers", ["--workers", "2"], ["worker", "group"]),
    ):
        folder = tmp_path / name
        folder.mkdir()
        destroy(folder, flags, victims, expected, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_hundred_kills(tmp_path: Path, expected: dict[str, str], seed: int) -> None:
    victims = random.Random(seed).choices(VICTIMS, k=25)
    destroy(tmp_path, ["--workers", "2"], victims, expected, seed)


def test_a_worker_deep_in_a_library_ends_with_its_parent(tmp_path: Path) -> None:
    """Python code cannot run there, so only the kernel can end it; otherwise the next run would wait for its lock."""
    workspace = Workspace(tmp_path, TOYS).write("stages:\n  a: {uses: crash, with: {how: library}}\n")
    process = commands.start(workspace, "--workers", "1")
    commands.await_that(lambda: commands.lines_told(workspace), "the stage")
    everyone = commands.descendants(process.pid)
    commands.kill(process.pid)
    process.wait(commands.LONGEST)
    commands.await_that(lambda: not any(map(commands.is_alive, everyone)), "the worker to end")
    leftovers = list(tmp_path.glob("store/temporary/*"))
    assert leftovers, "a killed run leaves something"
    status, _ = commands.call(workspace, "--serial", "--set", "a.how=never")
    assert status == 0
    assert not set(leftovers) & set(tmp_path.glob("store/temporary/*")), "the next run removes it"
