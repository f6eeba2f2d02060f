"""The main job, small: from photos to both reports, then a run with nothing to do, then only what a change affects."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.artifact import load
from stages.analysis.comparisons import read_comparisons
from stages.export_container import ExportContainerParameters, export_container
from stages.hiding.sealing import SEAL
from tests.running import run_stage
from tests.workflows.secret_windows import SecretWindows, everything_in, open_to_others, pieces_of

REPOSITORY = Path(__file__).parents[2]
SMALL = {
    "width": 64,
    "iterations": 30,
    "views": 18,
    "cover_photos.width": 256,
    "cover_photos.height": 192,
    "cover_photos.samples": 1,
    "cover_photos.processes": 1,  # each builds the scene, which takes longer than so few small pictures
    "cover.poses": "given",
    "message_photos.width": 256,
    "message_photos.height": 192,
    "message_photos.samples": 1,
    "message_photos.processes": 1,
    "message.poses": "given",
    "timings.frames": 2,
    "path.frames": 4,
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
    """Run the main job. Returns status, events and stderr; all output is also appended to a file beside the store."""
    process = start(store, *arguments, changes=changes)
    out, errors = process.communicate()
    with store.with_suffix(".printed").open("a") as file:
        file.write(out + errors)
    return process.returncode, [json.loads(line) for line in out.splitlines() if line.startswith("{")], errors


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, new_store: Callable[[Path], Path]) -> Path:
    folder = new_store(tmp_path_factory.mktemp("main_job") / "store")
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
    _, events, _ = run(store, "--serial", **{"hide.lambda_message": 1.0})
    ran = {event["name"] for event in events if event["event"] == "stage" and event["state"] == "ran"}
    assert ran == {"hide", "sealed", "published", "scores", "timings", "path", "report"}


def test_the_owner_sees_the_messages_and_the_public_does_not(store: Path) -> None:
    owner = (latest(store, "report.owner") / "report.html").read_text()
    public = (latest(store, "report.public") / "report.html").read_text()
    for name in ("workshop", "reef"):
        assert name in owner
        assert not re.search(name, public, re.IGNORECASE)
    assert owner.count("<video") == public.count("<video") == 1
    assert "http://" not in re.sub(r"http://www\.w3\.org\S*", "", owner + public)
    assert "https://" not in owner + public


def test_what_is_private_is_closed_to_others(store: Path) -> None:
    for name in ("hide.container", "sealed.secret", "key.key", "report.owner", "message_views[workshop].views"):
        matches = [path for path in (store / "latest" / "hide_multi").iterdir() if path.name == name]
        assert matches, f"{name} is not among the results"
        folder = matches[0].resolve()
        assert folder.stat().st_mode & 0o077 == 0
        assert all(path.stat().st_mode & 0o077 == 0 for path in folder.rglob("*"))


def test_public_pictures_show_the_cover_alone(store: Path) -> None:
    """Not the feature map, which is rendered from a container that the secret has opened."""
    public = read_comparisons(load(latest(store, "scores.public_pictures").resolve()))
    assert {picture.role for picture in public} == {"cover"}


def test_the_container_names_no_message(store: Path) -> None:
    folder = latest(store, "sealed.container").resolve()
    content = b"".join(path.read_bytes() for path in folder.rglob("*") if path.is_file())
    for word in (b"workshop", b"reef", b"message"):
        assert word not in content


def test_nothing_public_holds_a_piece_of_a_secret(store: Path, tmp_path: Path) -> None:
    """Neither the container, the reports, the bundle and the logs (even private ones), nor what the run printed."""
    container, secret, key = (
        load(latest(store, name).resolve()) for name in ("sealed.container", "sealed.secret", "key.key")
    )
    bundles = run_stage(
        export_container, ExportContainerParameters(), {"container": container, "secret": secret}, tmp_path
    )
    seal = str(secret.attributes[SEAL])
    pieces = [piece for artifact in (secret, key) for piece in pieces_of(artifact)]
    windows = SecretWindows([*pieces, seal.encode(), bytes.fromhex(seal)])
    searched = {**dict(open_to_others(store)), **dict(everything_in(bundles["bundle"]))}
    searched["printed"] = store.with_suffix(".printed").read_bytes()
    assert searched["printed"]
    assert {name: place for name, data in searched.items() if (place := windows.first_in(data)) is not None} == {}
    for name in ("sealed.container", "report.public", "scores.public_pictures", "path.public_videos"):
        assert any(each.startswith(str(latest(store, name).resolve())) for each in searched), name
    for part in ("logs", "actions", "runs"):
        assert any(each.startswith(str(store / part)) for each in searched), part
    held = [name for name, data in everything_in(bundles["secret_bundle"]) if windows.first_in(data) is not None]
    assert any(name.endswith("message_decoder.safetensors") for name in held), "the search would not have found it"


@pytest.mark.slow
def test_a_training_that_was_interrupted_and_killed_makes_the_same_bits(store: Path, tmp_path: Path) -> None:
    """With two messages and a key, in a worker. The module's store holds the result of an undisturbed training."""
    rough = tmp_path / "store"
    shutil.copytree(store, rough, symlinks=True)
    expected = forget(rough, "hide")
    assert run_until_checkpoint(rough, 3, signal.SIGINT) == 130
    (scratch,) = rough.glob("scratch/*")
    assert run_until_checkpoint(rough, 8, signal.SIGKILL) == -signal.SIGKILL
    assert list(rough.glob("scratch/*")) == [scratch]
    assert all(path.stat().st_mode & 0o077 == 0 for path in (scratch, *scratch.glob("checkpoint-*")))

    status, events, errors = run(rough, "hide", "--serial")
    assert status == 0, errors
    outputs = next(event["outputs"] for event in events if event.get("name") == "hide")
    assert {name: Path(path).name for name, path in outputs.items()} == expected
    log = (rough / "logs" / "hide_multi" / "private" / "hide.log").read_text()
    (iteration,) = re.findall(rf"goes on from iteration (\d+) of {SMALL['iterations']} \(checkpoint of 20", log)
    assert int(iteration) >= 8
    assert not list(rough.glob("scratch/*")), "it is committed"


def forget(store: Path, stage: str) -> dict[str, str]:
    """Remove a stage's records from a store. Returns the digests of its outputs with the workflow's own parameters."""
    outputs = {}
    for path in store.glob("actions/*/record.json"):
        record = json.loads(path.read_text())
        if record["provenance"]["name"] == stage:
            outputs[record["parts"]["parameters"]["lambda_message"]] = record["outputs"]
            shutil.rmtree(path.parent)
    return outputs[0.3]


def run_until_checkpoint(store: Path, number: int, how: signal.Signals) -> int:
    """Train with a checkpoint after every iteration; once checkpoint `number` is there, signal all processes."""
    process = start(store, "hide", "--workers", "1", changes={}, GS_HIDER_CHECKPOINT_SECONDS="0")
    while not any(int(path.name.partition("-")[2]) >= number for path in store.glob("scratch/*/checkpoint-*")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    os.killpg(process.pid, how)
    process.communicate()
    return process.returncode
