"""What all workflows have in common that hide something of one's own and end in a report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

WORKFLOWS = Path(__file__).parents[2] / "workflows"
HIDING = ("hide_photos", "hide_picture", "hide_scene", "hide_multi", "hide_splats", "hide_edits")


def stages_of(workflow: str) -> dict[str, Any]:
    stages: dict[str, Any] = yaml.safe_load((WORKFLOWS / f"{workflow}.yaml").read_text())["stages"]
    return stages


@pytest.mark.parametrize("workflow", HIDING)
def test_the_report_says_of_every_scene_how_many_photos_were_placed(workflow: str) -> None:
    stages = stages_of(workflow)
    placed = [name for name, stage in stages.items() if stage["uses"] == "sfm"]
    assert placed
    assert stages["report"]["in"]["scenes"] == placed


@pytest.mark.parametrize("workflow", [*HIDING, "batch_pairs"])
def test_what_is_hidden_can_be_published_as_files(workflow: str) -> None:
    """With the cover, along whose cameras others look at it."""
    stages = stages_of(workflow)
    published, cover = stages["published"], stages["hide"]["in"]["cover"]
    assert published["uses"] == "export_container"
    assert published["in"] == {"container": "hide.container", "secret": "hide.secret", "cover": cover}


def test_a_traced_scene_is_published_with_a_path_to_look_at_it_from() -> None:
    stages = stages_of("trace_pictures")
    assert stages["published"]["in"] == {"container": "grain.container", "cover": stages["grain"]["in"]["cover"]}
