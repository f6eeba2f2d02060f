"""A small batch of pairs from a CSV: shared work is done once, and one page has a row for each pair, failed or not."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from stages.imaging.pictures import encode_png
from stages.scene.transforms import FILE, OPENGL_TO_OPENCV
from stages.tracing.rig import look_at

REPOSITORY = Path(__file__).parents[2]
SMALL = {"width": 64, "iterations": 10, "scores.lpips": "none"}
VIEWS, WIDTH, HEIGHT = 12, 256, 192
PAIRS = "cover,message\ncourtyard,reef\ncourtyard,broken\ncourtyard,part of a reef\n"


def photograph(seed: int, folder: Path) -> None:
    """Write photos of a painted floor from all around, with their poses."""
    coarse = np.random.default_rng(seed).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    painting = cv2.resize(coarse, (1024, 1024), interpolation=cv2.INTER_CUBIC)
    painting_to_floor = np.array([[4 / 1024, 0, -2], [0, 4 / 1024, -2], [0, 0, 1]])
    folder.mkdir()
    frames = []
    for number in range(VIEWS):
        angle = 2 * np.pi * number / VIEWS
        world_to_camera = look_at(np.array([1.5 * np.cos(angle), 1.5 * np.sin(angle), 2.5]), np.zeros(3))
        intrinsics = np.array([[220.0, 0, WIDTH / 2], [0, 220.0, HEIGHT / 2], [0, 0, 1]])
        floor_to_photo = intrinsics @ world_to_camera[:3, [0, 1, 3]]
        photo = cv2.warpPerspective(painting, floor_to_photo @ painting_to_floor, (WIDTH, HEIGHT))
        name = f"{number:03d}.png"
        (folder / name).write_bytes(encode_png(photo))
        camera_to_world = np.linalg.inv(world_to_camera) @ OPENGL_TO_OPENCV
        frames.append({"file_path": name, "transform_matrix": camera_to_world.tolist()})
    (folder / FILE).write_text(json.dumps({"fl_x": 220.0, "frames": frames}))


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory, new_store: Callable[[Path], Path]) -> Path:
    """A cover, a message, a copy of the message with a damaged first photo, and a part of the message."""
    folder = tmp_path_factory.mktemp("photos")
    for seed, name in enumerate(("courtyard", "reef")):
        photograph(seed, folder / name)
    for name, kept in {"broken": VIEWS, "part of a reef": VIEWS - 2}.items():
        (folder / name).mkdir()
        content = json.loads((folder / "reef" / FILE).read_text())
        frames = content["frames"][:kept]
        for frame in frames:
            photo = frame["file_path"]
            (folder / name / photo).write_bytes((folder / "reef" / photo).read_bytes())
        (folder / name / FILE).write_text(json.dumps({**content, "frames": frames}))
    damaged = folder / "broken" / "000.png"
    damaged.write_bytes(damaged.read_bytes()[:500])
    (folder / "pairs.csv").write_text(PAIRS)
    new_store(folder / "store")
    return folder


def run(photos: Path) -> tuple[int, dict[str, dict], str]:
    """Run the batch. Returns the exit status, the final events of stages by name, and what was written to stderr."""
    settings = [f"--set={name}={value}" for name, value in {**SMALL, "pairs": photos / "pairs.csv"}.items()]
    command = [sys.executable, "-m", "pipeline", "run", "workflows/batch_pairs.yaml", "--json", "--serial"]
    finished = subprocess.run(
        [*command, "--store", str(photos / "store"), *settings],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    events = [json.loads(line) for line in finished.stdout.splitlines() if line.startswith("{")]
    return finished.returncode, {event["name"]: event for event in events if event["event"] == "stage"}, finished.stderr


def test_three_pairs_that_share_a_cover(photos: Path) -> None:
    status, ended, said = run(photos)
    assert status == 1, said
    states = {name: event["state"] for name, event in ended.items()}
    shared = [name for name in states if name.partition("[")[0] in ("cover_photos", "cover", "plain")]
    assert shared == ["cover_photos[courtyard]", "cover[courtyard]", "plain[courtyard]"], said
    assert states["message_photos[broken]"] == "failed"
    assert states["scores[courtyard,broken]"] == "skipped"
    assert [name for name, state in states.items() if state == "failed"] == ["message_photos[broken]"]
    assert states["table"] == "ran"

    owner, public = (Path(ended["table"]["outputs"][name]) for name in ("owner", "public"))
    page = (owner / "report.html").read_text()
    assert "2 of 3 made, 1 failed." in page
    assert "failed: message_photos: broken/000.png: a picture cannot be read" in page
    with (owner / "figures.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["cover"], row["message"]) for row in rows] == [
        ("courtyard", "reef"),
        ("courtyard", "broken"),
        ("courtyard", "part of a reef"),
    ]
    assert [bool(row["failed"]) for row in rows] == [False, True, False]
    for row in (rows[0], rows[2]):
        for figure in ("cover_psnr", "message_psnr", "reference_psnr", "scene_container_bytes", "scene_gaussians"):
            assert float(row[figure]) > 0
    for word in ("reef", "broken", "message", "hid", "secret", "cover", "fail"):
        assert word not in (public / "report.html").read_text().casefold()
    assert owner.stat().st_mode & 0o077 == 0

    (photos / "broken" / "000.png").write_bytes((photos / "reef" / "000.png").read_bytes())
    status, ended, said = run(photos)
    assert status == 0, said
    ran = {name for name, event in ended.items() if event["state"] == "ran"}
    assert ran == {"table"}, "the repaired folder holds what the reef's does"
    assert "3 of 3 made." in (Path(ended["table"]["outputs"]["owner"]) / "report.html").read_text()
