"""The main job, small: from photos to both reports, then nothing to do, then only what a change asks for."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
SMALL = {
    "width": 64,
    "iterations": 30,
    "views": 24,
    "cover_photos.width": 256,
    "cover_photos.height": 192,
    "cover_photos.samples": 1,
    "cover.poses": "given",
    "message_photos.width": 256,
    "message_photos.height": 192,
    "message_photos.samples": 1,
    "message.poses": "given",
    "timings.frames": 2,
    "scores.lpips": "none",
    "hide.precision": "float32",
}


def start(store: Path, *arguments: str, changes: dict[str, object], **environment: str) -> subprocess.Popen[str]:
    settings = [f"--set={name}={value}" for name, value in (SMALL | changes).items()]
    command = [sys.executable, "-m", "pipeline", "run", "workflows/hide_multi.yaml", "--store", str(store), "--json"]
    return subprocess.Popen(
        [*command, *settings, *arguments],
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"} | environment,
        start_new_session=True,
    )


def run(store: Path, *arguments: str, **changes: object) -> tuple[int, list[dict], str]:
    process = start(store, *arguments, changes=changes)
    out, errors = process.communicate()
    return process.returncode, [json.loads(line) for line in out.splitlines() if line.startswith("{")], errors


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("store")
    status, events, errors = run(folder)
    assert status == 0, errors
    assert events[-1]["event"] == "summary"
    assert events[-1]["failed"] == 0
    return folder


def latest(store: Path, name: str) -> Path:
    return store / "latest" / "hide_multi" / name


def test_a_second_run_executes_nothing(store: Path) -> None:
    status, events, _ = run(store)
    assert status == 0
    assert events[-1]["ran"] == 0
    assert {event["state"] for event in events if event["event"] == "stage"} == {"cached"}


def test_another_lambda_reruns_exactly_what_depends_on_it(store: Path) -> None:
    _, events, _ = run(store, **{"hide.lambda_message": 1.0})
    ran = {event["name"] for event in events if event["event"] == "stage" and event["state"] == "ran"}
    assert ran == {"hide", "scores", "timings", "report"}


def test_the_owner_sees_the_messages_and_the_public_does_not(store: Path) -> None:
    owner = (latest(store, "report.owner") / "report.html").read_text()
    public = (latest(store, "report.public") / "report.html").read_text()
    for name in ("workshop", "reef"):
        assert name in owner
        assert not re.search(name, public, re.IGNORECASE)
    assert "http://" not in re.sub(r"http://www\.w3\.org\S*", "", owner + public)
    assert "https://" not in owner + public


def test_what_is_private_is_closed_to_others(store: Path) -> None:
    for name in ("hide.secret", "key.key", "report.owner", "message_views[workshop].views"):
        matches = [path for path in (store / "latest" / "hide_multi").iterdir() if path.name == name]
        assert matches, f"{name} is not among the results"
        folder = matches[0].resolve()
        assert folder.stat().st_mode & 0o077 == 0
        assert all(path.stat().st_mode & 0o077 == 0 for path in folder.rglob("*"))


def test_the_container_names_no_message(store: Path) -> None:
    folder = latest(store, "hide.container").resolve()
    content = b"".join(path.read_bytes() for path in folder.rglob("*") if path.is_file())
    for word in (b"workshop", b"reef", b"message"):
        assert word not in content


TRAININGS = {"plain": "logs/hide_multi/plain.log", "hide": "logs/hide_multi/private/hide.log"}
LONGER = {"plain.iterations": 240, "hide.iterations": 60, "hide.layers": 2, "hide.decoder_width": 8}


def run_until_checkpoints(store: Path, number: int, how: signal.Signals) -> int:
    """Trains with a checkpoint after every iteration; once each stage has the one of that number, all get a signal."""
    changes: dict[str, object] = dict(LONGER)
    process = start(store, *TRAININGS, changes=changes, GS_HIDER_CHECKPOINT_SECONDS="0")
    while len(checkpoints_from(store, number)) < len(TRAININGS):
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    os.killpg(process.pid, how)
    process.communicate()
    return process.returncode


def checkpoints_from(store: Path, number: int) -> set[Path]:
    """Scratch directories with a checkpoint of that number or a later one."""
    found = store.glob("scratch/*/checkpoint-*")
    return {path.parent for path in found if int(path.name.partition("-")[2]) >= number}


def trained(store: Path) -> tuple[dict[str, dict[str, str]], dict[str, str]]:
    """Digests of what both trainings made, and their logs."""
    status, events, errors = run(store, *TRAININGS, **LONGER)
    assert status == 0, errors
    outputs = {event["name"]: event["outputs"] for event in events if event.get("name") in TRAININGS}
    digests = {name: {port: Path(path).name for port, path in made.items()} for name, made in outputs.items()}
    return digests, {name: (store / log).read_text() for name, log in TRAININGS.items()}


def test_trainings_that_were_interrupted_and_killed_make_the_same_bits(store: Path, tmp_path: Path) -> None:
    calm, rough = tmp_path / "calm", tmp_path / "rough"
    for copy in (calm, rough):
        shutil.copytree(store, copy, symlinks=True)
    expected, logs = trained(calm)
    assert "goes on from iteration" not in "".join(logs.values())

    assert run_until_checkpoints(rough, 4, signal.SIGINT) == 130
    folders = checkpoints_from(rough, 4)
    assert run_until_checkpoints(rough, 9, signal.SIGKILL) == -signal.SIGKILL
    assert checkpoints_from(rough, 9) == folders
    for folder in folders:
        paths = [folder, *folder.rglob("*")]
        assert all(path.stat().st_mode & 0o077 == 0 for path in paths if ".checkpoint-" not in str(path))

    digests, logs = trained(rough)
    for name, total in (("plain", 240), ("hide", 60)):
        (at,) = re.findall(rf"goes on from iteration (\d+) of {total} \(checkpoint of 20", logs[name])
        assert 9 <= int(at) < total
    assert digests == expected
    assert not list(rough.glob("scratch/*"))
