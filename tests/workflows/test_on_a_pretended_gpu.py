"""Owners' workflows on a pretended GPU: no stage mixes tensors of two devices, whatever the stages before it made."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from opencl.device import DEVICE_VARIABLE
from stages.imaging.pictures import encode_png
from tests.pretended_gpu import NAME, available
from tests.stages.scene.splat_files.files import columns, write_ply
from tests.workflows.test_batch_pairs import photograph
from tests.workflows.test_published import REPOSITORY
from tests.workflows.test_published import run as run_workflow

pytestmark = [
    pytest.mark.slow,  # a minute or two each: every operation of torch goes through Python
    pytest.mark.skipif(not available, reason="this torch can be told of no device that is written in Python"),
]
TINY = {"width": 64, "iterations": 10, "scores.lpips": "none", "timings.frames": 2, "path.frames": 3}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, new_store: Callable[[Path], Path]) -> Path:
    """Photos of a cover and of a message, splats, a picture, and a store with what `hide_photos` makes of them."""
    folder = tmp_path_factory.mktemp("owner")
    for seed, name in enumerate(("cover", "message")):
        photograph(seed, folder / name)
    write_ply(folder / "splats.ply", columns(200, 1))
    picture = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    (folder / "picture.png").write_bytes(encode_png(picture))
    new_store(folder / "store")
    given = {"cover": folder / "cover", "message": folder / "message", "grain": 1.5}
    run(folder, "hide_photos", **given, **TINY)
    return folder


def run(folder: Path, workflow: str, **settings: object) -> None:
    made = run_workflow(
        REPOSITORY / "workflows" / f"{workflow}.yaml",
        folder / "store",
        *(f"--set={name}={value}" for name, value in settings.items()),
        module="tests.workflows.pretended_gpu_run",
        **{DEVICE_VARIABLE: "portable computing"},
    )
    assert made
    records = (folder / "store" / "actions").glob("*/record.json")
    assert any(f"tensors copied from {NAME}" in record.read_text() for record in records), "nothing was pretended"


def kept(folder: Path) -> Path:
    return folder / "store" / "latest" / "hide_photos"


def test_a_found_container_is_recovered_and_read(folder: Path) -> None:
    found = kept(folder) / "published.bundle" / "container.ply"
    run(folder, "recover_container", found=found, hidden=kept(folder), **{"path.frames": 3})


def test_a_friend_sees_the_message(folder: Path) -> None:
    secret = {"container.secret": kept(folder) / "published.secret_bundle"}
    run(folder, "view_container", bundle=kept(folder) / "published.bundle", **secret)


def test_pictures_are_traced(folder: Path) -> None:
    run(folder, "trace_hidden", hidden=kept(folder), pictures=folder / "cover")


def test_a_picture_is_hidden(folder: Path) -> None:
    run(folder, "hide_picture", cover=folder / "cover", picture=folder / "picture.png", **TINY)


def test_splats_are_hidden(folder: Path) -> None:
    run(folder, "hide_splats", cover=folder / "cover", message=folder / "splats.ply", up="z", **TINY)


def test_an_edited_cover_is_hidden(folder: Path) -> None:
    run(folder, "hide_edits", cover=folder / "cover", **TINY)
