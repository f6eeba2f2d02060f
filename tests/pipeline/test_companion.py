"""Companion processes: all that they say is heard, they are killed with the stage, and their failures are reported."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.companion import ROOT, Said, work_together
from pipeline.errors import Interrupted, UserError

MODULE = "tests.pipeline.companion_process"
LONG = 600


def jobs(directory: Path, *contents: dict[str, object]) -> list[Path]:
    paths = [directory / f"{number}.json" for number in range(len(contents))]
    for number, (path, content) in enumerate(zip(paths, contents, strict=True)):
        path.write_text(json.dumps({"name": number} | content))
    return paths


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{process}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"


def has_ended(process: int) -> bool:
    for _ in range(100):
        if not alive(process):
            return True
        time.sleep(0.1)
    return False


def nothing() -> None:
    pass


def test_all_companions_are_heard_to_their_ends(tmp_path: Path) -> None:
    said: list[Said] = []
    work_together("work", MODULE, jobs(tmp_path, {}, {"seconds": 0.5}, {}), said.append, nothing)
    assert sorted(one["name"] for one in said if "done" in one) == [0, 1, 2]
    assert len({one["process"] for one in said if "process" in one}) == 3


def test_without_jobs_nothing_happens() -> None:
    work_together("work", MODULE, [], lambda said: pytest.fail("heard"), nothing)


@pytest.mark.parametrize("given", [None, "", os.pathsep])
def test_nothing_is_run_from_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str | None
) -> None:
    if given is None:
        monkeypatch.delenv("PYTHONPATH", raising=False)
    else:
        monkeypatch.setenv("PYTHONPATH", given)
    (tmp_path / "json.py").write_text("raise SystemExit('a file of the current folder was run')\n")
    listed = jobs(tmp_path, {})
    monkeypatch.chdir(tmp_path)
    said: list[Said] = []
    work_together("work", MODULE, listed, said.append, nothing)
    assert said[-1]["done"]


def test_one_that_breaks_off_is_told_and_ends_the_others(tmp_path: Path) -> None:
    processes: list[int] = []

    def heard(said: Said) -> None:
        processes.append(said["process"])

    listed = jobs(tmp_path, {"seconds": 1, "status": 3}, {"seconds": LONG})
    with pytest.raises(UserError) as error:
        work_together("printing", MODULE, listed, heard, nothing, remedy="Buy paper.")
    assert "printing failed; found exit status 3: about to begin | no more paper" in str(error.value)
    assert "Buy paper." in str(error.value)
    assert len(processes) == 2
    assert not any(alive(process) for process in processes)


@pytest.mark.parametrize("by", ["heard", "watch"])
def test_a_stop_ends_them(tmp_path: Path, by: str) -> None:
    processes: list[int] = []

    def heard(said: Said) -> None:
        processes.append(said["process"])
        if by == "heard":
            raise Interrupted

    def watch() -> None:
        if by == "watch" and processes:
            raise Interrupted

    with pytest.raises(Interrupted):
        work_together("work", MODULE, jobs(tmp_path, {"seconds": LONG}), heard, watch)
    assert not any(alive(process) for process in processes)


def test_they_end_with_a_stage_that_is_killed(tmp_path: Path) -> None:
    listed = jobs(tmp_path, {"seconds": LONG})
    program = (
        "import sys; from pathlib import Path; from pipeline.companion import work_together\n"
        "work_together('work', sys.argv[1], [Path(sys.argv[2])], lambda said: print(said['process'], flush=True), int)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, MODULE, str(listed[0])], stdout=subprocess.PIPE, cwd=ROOT
    ) as stage:
        assert stage.stdout is not None
        companion = int(stage.stdout.readline())
        assert alive(companion)
        stage.send_signal(signal.SIGKILL)
    assert has_ended(companion)


@pytest.mark.parametrize(("raised", "remedied"), [("a lens that folds over", False), ("", True)])
def test_the_remedy_for_want_of_memory_is_told_for_nothing_else(tmp_path: Path, raised: str, remedied: bool) -> None:
    listed = jobs(tmp_path, {"seconds": 0, "raises": raised})
    with pytest.raises(UserError) as error:
        work_together("mapping", MODULE, listed, lambda said: None, nothing, remedy="Buy more.")
    assert ("Buy more." in str(error.value)) == remedied
    if raised:
        assert str(error.value) == f"mapping failed; found {raised}"
