"""The main job, small: from photos to both reports, then nothing to do, then only what a change asks for."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
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


def run(store: Path, *arguments: str, **changes: object) -> tuple[int, list[dict], str]:
    settings = [f"--set={name}={value}" for name, value in (SMALL | changes).items()]
    command = [sys.executable, "-m", "pipeline", "run", "workflows/hide_multi.yaml", "--store", str(store), "--json"]
    finished = subprocess.run(
        [*command, *settings, *arguments],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    events = [json.loads(line) for line in finished.stdout.splitlines() if line.startswith("{")]
    return finished.returncode, events, finished.stderr


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
