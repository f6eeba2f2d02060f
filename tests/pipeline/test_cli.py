"""The command line as a user meets it: exit statuses, JSON, no traceback; and dask's worker processes."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from tests.pipeline.helpers import CHAIN, TOYS, Workspace

ROOT = Path(__file__).parents[2]


def start(workspace: Workspace, command: str, *arguments: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "GS_HIDER_STORE": str(workspace.folder / "store"), "COLUMNS": "100"}
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline", command, str(workspace.file), "--stages", TOYS, *arguments],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def call(workspace: Workspace, command: str, *arguments: str) -> tuple[int, str, str]:
    """Exit status, stdout and stderr; fails if there is a traceback."""
    process = start(workspace, command, *arguments)
    out, err = process.communicate(timeout=100)
    assert "Traceback" not in err
    return process.returncode, out, err


def test_run_twice_on_workers(workspace: Workspace) -> None:
    """Spawned workers do everything once; the second run is cached. The keys are those of a run in one process."""
    workspace.write(CHAIN)
    with socket.socket() as dashboard:  # another dask's
        with suppress(OSError):
            dashboard.bind(("", 8787))
            dashboard.listen()
        status, out, err = call(workspace, "run", "--json", "--workers", "2")
    lines = [json.loads(line) for line in out.splitlines()]
    assert (status, err) == (0, "")
    assert lines[-1] | {"seconds": 0} == {
        "event": "summary",
        "ran": 4,
        "cached": 0,
        "failed": 0,
        "skipped": 0,
        "seconds": 0,
    }
    status, out, _ = call(workspace, "run", "--json")
    again = [json.loads(line) for line in out.splitlines()]
    assert [line["state"] for line in again[:-1]] == ["cached"] * 4
    assert {line["name"]: line["outputs"] for line in again[:-1]} == {
        line["name"]: line["outputs"] for line in lines[:-1]
    }
    other = Workspace(workspace.folder / "other")
    other.folder.mkdir()
    alone = other.write(CHAIN).run()
    assert {name: event.key for name, event in alone.ended.items()} == {
        line["name"]: line["key"] for line in again[:-1]
    }


def test_failures_and_a_dying_worker(workspace: Workspace) -> None:
    workspace.write("""
        stages:
          base:  {uses: numbers}
          dies:  {uses: fail, in: {numbers: base}, with: {how: death}}
          after: {uses: scale, in: {numbers: dies}}
          bad:   {uses: fail, in: {numbers: base}, with: {how: user}}
          fine:  {uses: scale, in: {numbers: base}}
        """)
    status, out, err = call(workspace, "run", "--workers", "1")
    assert status == 1
    assert "dies: failed: its worker process died" in err
    (attempts,) = workspace.folder.glob("store/scratch/*/attempts")
    assert len(attempts.read_text()) <= 2, "once more only if nobody heard that it had begun"
    assert f"bad: failed: photos/: no pictures; expected JPEG or PNG files. Look there. (log: {workspace.folder}" in err
    assert "after: skipped: needs dies, which was not made" in err
    assert "fine: done in" in err
    assert "workflow: 2 ran, 2 failed, 1 skipped" in err
    assert f"continue with: {sys.executable} -m pipeline run {workspace.file}" in err
    assert "The store is" in out


def test_two_runs_at_once_do_each_action_once(workspace: Workspace) -> None:
    workspace.write(CHAIN)
    processes = [start(workspace, "run", "--serial", "--json") for _ in range(2)]
    summaries = [json.loads(process.communicate(timeout=100)[0].splitlines()[-1]) for process in processes]
    assert sum(summary["ran"] for summary in summaries) == 4
    assert sum(summary["cached"] for summary in summaries) == 4


def test_workers_may_use_every_core(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """dask's nanny would set OMP_NUM_THREADS=1; our workers only get a setting that lets idle threads sleep."""
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    workspace.write("stages:\n  a: {uses: environment}\n")
    status, out, _ = call(workspace, "run", "--json", "--workers", "1")
    found = json.loads((Path(json.loads(out.splitlines()[0])["outputs"]["page"]) / "report.html").read_text())
    assert status == 0
    assert found["OMP_NUM_THREADS"] is None
    assert found["OMP_WAIT_POLICY"] == "PASSIVE"
    assert found["POCL_CACHE_DIR"] == str(workspace.folder / "kernels" / "process-0")


@pytest.mark.parametrize("flags", [["--serial"], ["--workers", "1"]])
def test_interrupted_and_resumed(workspace: Workspace, flags: list[str]) -> None:
    """Ctrl-C goes to the whole process group, as in a terminal."""
    workspace.write("stages:\n  half: {uses: wait}\n  after: {uses: scale, in: {numbers: half}}\n")
    process = start(workspace, "run", *flags)
    deadline = time.monotonic() + 60
    while not list(workspace.folder.glob("store/scratch/*")):
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert "half: skipped: stopped\n" in err
    assert f"To continue: {sys.executable} -m pipeline run {workspace.file}" in err
    status, _, err = call(workspace, "run", "--serial")
    assert (status, "half: done" in err) == (0, True)
    assert not list(workspace.folder.glob("store/scratch/*")), "the checkpoint is deleted at commit"


def test_wrong_workflows_and_commands_are_status_2(workspace: Workspace) -> None:
    workspace.write("stages:\n  a: {usess: numbers}\n  b: {uses: scale}\n")
    status, out, err = call(workspace, "run", "--json", "--set", "c=1")
    assert (status, out) == (2, "")
    assert f"{workspace.file}:2:7: unknown key 'usess'" in err
    assert f"{workspace.file}:3:3: input 'numbers'" in err
    assert "--set c: no such var" in err
    assert len(err.splitlines()) == 4
    assert call(workspace, "run", "--nonsense")[0] == 2
    assert "expected NAME=AMOUNT" in call(workspace, "run", "--resources", "gpu")[2]
    assert call(workspace, "run", "--scheduler", "nonsense")[0] == 2
    workspace.file.unlink()
    status, _, err = call(workspace, "status")
    assert (status, err) == (
        2,
        f"{workspace.file}: cannot read the workflow; found No such file or directory; expected a YAML file\n",
    )
    workspace.file.with_name("workflows.yaml").touch()
    assert f"did you mean '{workspace.file.with_name('workflows.yaml')}'?" in call(workspace, "status")[2]


def test_dry_run_status_explain_graph(workspace: Workspace) -> None:
    workspace.write(CHAIN)
    status, out, _ = call(workspace, "run", "--dry-run")
    assert status == 0
    assert out.splitlines()[0] == "base   to run  it has never run"
    assert not (workspace.folder / "store/actions").exists(), "nothing ran"
    workspace.run()
    assert "4 cached" in call(workspace, "status")[1]
    plan = call(workspace, "status", "--json", "--set", "factor=4")[1].splitlines()
    assert [json.loads(line)["state"] for line in plan] == ["cached", "run", "cached", "depends"]
    assert call(workspace, "explain", "twice", "--set", "factor=4")[1] == (
        "twice: to run, because\n  parameter factor: 2.0 → 4.0\n"
    )
    assert "twice: cached\n  made 2" in call(workspace, "explain", "twice")[1]
    assert call(workspace, "graph")[1].splitlines()[-1] == "sum    total  ← twice, other"
    assert json.loads(call(workspace, "graph", "--json")[1].splitlines()[-1])["inputs"] == {
        "numbers": ["twice.numbers", "other.numbers"],
        "weights": [],
    }
    picture = workspace.folder / "graph.svg"
    assert call(workspace, "graph", "--svg", str(picture))[0] == 0
    assert ">twice</text>" in picture.read_text()


def test_a_graph_is_drawn_in_utf_8_whatever_the_locale(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    workspace.file.write_text(
        'stages:\n  room: {foreach: {word: [Küche]}, uses: say, with: {word: "${item.word}"}}\n', encoding="utf-8"
    )
    for name, value in {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}.items():
        monkeypatch.setenv(name, value)
    picture = workspace.folder / "graph.svg"
    assert call(workspace, "graph", "--svg", str(picture))[0] == 0
    assert ">room[Küche]</text>" in picture.read_text(encoding="utf-8")


def test_a_graph_cannot_be_drawn_to_a_folder_or_into_none(workspace: Workspace) -> None:
    workspace.write(CHAIN)
    for target, found in ((workspace.folder, "Is a directory"), (workspace.folder / "no/graph.svg", "No such file")):
        status, out, err = call(workspace, "graph", "--svg", str(target))
        assert (status, out, len(err.splitlines())) == (2, "", 1)
        assert f"{target}: the graph cannot be drawn there; found {found}" in err


def test_the_end_names_what_to_open(workspace: Workspace) -> None:
    status, out, err = call(workspace.write(CHAIN), "run", "--serial")
    assert (status, out) == (
        0,
        f"Open {workspace.folder}/store/latest/chain/sum.page/report.html\nThe store is {workspace.folder}/store\n",
    )
    assert err.splitlines()[-1].startswith("chain: 4 ran in ")


def test_a_cached_run_loads_nothing_heavy(workspace: Workspace) -> None:
    """It loads neither the stages nor torch, zarr, NumPy or dask, and so is short."""
    workspace.write(CHAIN).run()
    script = (
        "import sys; from pathlib import Path; from pipeline import cli\n"
        f"try: cli.app(['run', {str(workspace.file)!r}, '--stages', {TOYS!r}, '--store', sys.argv[1]])\n"
        "except SystemExit as end: assert not end.code\n"
        f"heavy = {{'torch', 'zarr', 'numpy', 'dask', 'distributed', '{TOYS}.scale'}}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(workspace.folder / "store")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == "[]"
    assert "4 cached" in done.stderr
