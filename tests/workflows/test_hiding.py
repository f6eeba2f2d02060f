"""What the workflows that hide or trace something have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.workflows.test_own_workflow import example_in

WORKFLOWS = Path(__file__).parents[2] / "workflows"
HIDING = ("hide_photos", "hide_picture", "hide_scene", "hide_multi", "hide_splats", "hide_edits")
ONES_OWN = ("hide_photos", "hide_picture", "hide_splats", "hide_edits", "batch_pairs")
"""Workflows for content of one's own. The others hide built-in captures, with keys that anyone can draw."""


def written(workflow: str) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((WORKFLOWS / f"{workflow}.yaml").read_text())
    return content


def stages_of(workflow: str) -> dict[str, Any]:
    stages: dict[str, Any] = written(workflow)["stages"]
    return stages


@pytest.mark.parametrize("workflow", HIDING)
def test_the_report_says_of_every_scene_how_many_photos_were_placed(workflow: str) -> None:
    stages = stages_of(workflow)
    placed = [name for name, stage in stages.items() if stage["uses"] == "sfm"]
    assert placed
    assert stages["report"]["in"]["scenes"] == placed


@pytest.mark.parametrize("workflow", [*HIDING, "batch_pairs"])
def test_what_is_hidden_can_be_published_as_files(workflow: str) -> None:
    """It is sealed and has the cover, whose cameras give others a path to view it; unsealed, it stays private."""
    stages = stages_of(workflow)
    published, sealed, cover = stages["published"], stages["sealed"], stages["hide"]["in"]["cover"]
    assert published["uses"] == "export_container"
    assert published["in"] == {"container": "sealed.container", "secret": "sealed.secret", "cover": cover}
    assert sealed["uses"] == "seal"
    container = "grain.container" if workflow in ONES_OWN else "hide.container"
    assert sealed["in"] == {"container": container, "secret": "hide.secret", "key": "key"}
    assert stages["hide"]["private"] is True


@pytest.mark.parametrize("workflow", ONES_OWN)
def test_what_is_hidden_can_have_a_grain_before_it_is_sealed(workflow: str) -> None:
    """By default it has none. The grain has a key of its own, and the result is private until it is sealed."""
    stages = stages_of(workflow)
    assert written(workflow)["vars"]["grain"] == 0
    grain, cover = stages["grain"], stages["hide"]["in"]["cover"]
    assert grain["uses"] == "add_grain"
    assert grain["private"] is True
    assert grain["with"] == {"method": "${method}", "level": "${grain}"}
    assert grain["in"] == {"container": "hide.container", "secret": "hide.secret", "cover": cover, "key": "grain_key"}
    assert stages["grain_key"].keys() <= {"uses", "in", "foreach"}
    assert stages["grain_key"]["in"] != stages["key"]["in"], "the same would draw the same key"


def test_a_traced_scene_is_published_with_a_path_to_look_at_it_from() -> None:
    stages = stages_of("trace_pictures")
    assert stages["published"]["in"] == {"container": "grain.container", "cover": stages["grain"]["in"]["cover"]}


def sources_of(stages: dict[str, Any], stage: str) -> set[str]:
    """The stage, and all stages that its inputs come from."""
    given = [
        name
        for value in stages[stage].get("in", {}).values()
        for name in ([value] if isinstance(value, str) else value)
    ]
    return {stage}.union(*(sources_of(stages, name.partition(".")[0]) for name in given))


@pytest.mark.parametrize("workflow", ["trace_pictures", "README"])
def test_what_shows_a_grain_is_private_and_so_is_all_that_it_can_be_trained_from(workflow: str) -> None:
    if workflow == "README":
        stages = yaml.safe_load(example_in((WORKFLOWS / "README.md").read_text()))["stages"]
    else:
        stages = stages_of(workflow)
    before = stages["grain"]["in"]["container"].partition(".")[0]
    assert {stages[name]["uses"] for name in sources_of(stages, before)} >= {"photos", "sfm", "train_scene"}
    assert not {name for name in sources_of(stages, before) if not stages[name].get("private")}


@pytest.mark.parametrize("workflow", ["trace_pictures", "trace_hidden"])
def test_pictures_that_are_looked_at_are_private_as_they_may_be_the_photos(workflow: str) -> None:
    assert stages_of(workflow)["suspects"].get("private")


def test_what_traces_a_hidden_scene_takes_what_the_workflows_that_hide_one_make() -> None:
    """It finds these by their names in `latest/`."""
    stages = stages_of("trace_hidden")
    taken = [str(value) for stage in stages.values() for value in stage.get("with", {}).values()]
    names = {value.removeprefix("${hidden}/").partition(".")[0] for value in taken if value.startswith("${hidden}/")}
    assert names == {"hide", "grain", "grain_key", "cover_scene"}
    for workflow in set(ONES_OWN) - {"batch_pairs"}:
        assert names <= stages_of(workflow).keys()
