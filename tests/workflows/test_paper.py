"""The paper's nine pairs, planned on almost empty captures with the layout of Mip-NeRF 360."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.console.project import open_project
from tests.stages.scene.test_colmap import write_binary_model
from tests.stages.test_photos import take

REPOSITORY = Path(__file__).parents[2]
TEX = REPOSITORY.parent / "shared" / "paper" / "gs-hider.tex"
WORKFLOW = REPOSITORY / "workflows" / "paper.yaml"
OUTDOORS, INDOORS = ("bicycle", "flowers", "garden", "stump", "treehill"), ("bonsai", "counter", "kitchen", "room")
ROW = re.compile(r'- \{cover: (\w+), .*message: "?(?:\$\{)?(\w+)\}?"?, .*method: gs_hider, hidden: 1\}')


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory, new_store: Callable[[Path], Path]) -> Path:
    folder = tmp_path_factory.mktemp("data")
    for scene in (*OUTDOORS, *INDOORS, "db/playroom"):
        for images, size in (("images", (64, 48)), ("images_2", (32, 24)), ("images_4", (16, 12))):
            if images == "images" or scene != "db/playroom":
                take(folder / scene / images / "a.jpg", size)
                take(folder / scene / images / "b two.jpg", size)
        write_binary_model(folder / scene / "sparse" / "0")
    new_store(folder / "store")
    return folder


def test_all_pairs_are_planned_and_what_they_share_once(data: Path) -> None:
    command = [sys.executable, "-m", "pipeline", "run", str(WORKFLOW), "--dry-run", "--store", str(data / "store")]
    planned = subprocess.run(
        [*command, f"--set=data={data}", "--set=playroom=db/playroom"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert planned.returncode == 0, planned.stderr
    said = planned.stdout + planned.stderr
    for cover in (*OUTDOORS, *INDOORS):
        images = "images_4" if cover in OUTDOORS else "images_2"
        assert f"cover_photos[{cover},{images}]" in said, said
    names = set(re.findall(r"\b(\w+)\[([^\]]+)\]", said))
    counts = {stage: len({row for name, row in names if name == stage}) for stage in ("cover", "message", "hide")}
    assert counts == {"cover": 9, "message": 5, "hide": 45}


def test_the_table_can_be_made_again(data: Path) -> None:
    nodes = open_project(WORKFLOW, data / "store", [f"data={data}", "playroom=db/playroom"]).graph.nodes
    assert not [name for name, node in nodes.items() if node.unrepeatable]


def test_the_released_codes_constants_are_taken(data: Path) -> None:
    command = [sys.executable, "-m", "pipeline", "run", str(WORKFLOW), "--dry-run", "--store", str(data / "store")]
    constants = REPOSITORY / "workflows" / "profiles" / "released_code.yaml"
    row = "{cover: bonsai, images: images_2, message: counter, message_images: images_2, method: gs_hider, hidden: 1}"
    planned = subprocess.run(
        [*command, f"--set=data={data}", f"--vars={constants}", f"--set=rows=[{row}]"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert planned.returncode == 0, planned.stderr


@pytest.mark.skipif(not TEX.is_file(), reason="the paper is not at hand")
def test_the_pairs_are_the_papers() -> None:
    table = TEX.read_text().split("label{correspondence}")[0].rpartition("Original Scene")[2]
    covers, messages = (re.findall(r"[A-Z][a-z]+", line) for line in table.replace("Hidden Scene", "").splitlines()[:2])
    correspondence = {cover.lower(): message.lower() for cover, message in zip(covers, messages, strict=True)}
    assert len(correspondence) == 9
    assert dict(ROW.findall(WORKFLOW.read_text())) == correspondence
