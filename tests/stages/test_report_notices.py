"""What is amiss stands at the top of the owner's page, such as photos left out, or messages that nobody will see.

The public page says only how many photos were placed.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.stage import Item, Services
from stages.report import ReportParameters, report
from tests.running import run_stage
from tests.stages.test_report import LINEAGE, PLANTED, PRIVATE_ROWS, PUBLIC_ROWS, metrics, pages, text_of, top_of


@pytest.fixture
def inputs(tmp_path: Path) -> dict[str, tuple[Artifact, ...]]:
    return {
        "scores": (metrics(tmp_path / "scores", PUBLIC_ROWS + PRIVATE_ROWS, True),),
        "public_scores": (metrics(tmp_path / "public_scores", PUBLIC_ROWS, False),),
    }


def scenes(folder: Path, **made: tuple[int, int, bool]) -> dict[str, tuple[Item, ...]]:
    """Scenes by the names of their stages: photos placed, photos in all, and whether the scene is private."""
    items = []
    for number, (stage, (registered, total, private)) in enumerate(made.items()):
        with create(folder / str(number), "scene", private) as writer:
            writer.attributes |= {"registered": registered, "total": total}
            writer.write_file("points.txt", "none")
        items.append(Item(stage, {}, stage, load(folder / str(number))))
    return {"scenes": tuple(items)}


def with_scenes(inputs: dict, items: dict[str, tuple[Item, ...]], folder: Path) -> dict[str, Artifact]:
    given = {**inputs, **{name: tuple(item.artifact for item in group) for name, group in items.items()}}
    services = Services(lineage=lambda: LINEAGE)
    return run_stage(report, ReportParameters(), given, folder, services=services, items=items)


def test_how_many_photos_were_placed_stands_at_the_top(inputs: dict, tmp_path: Path) -> None:
    items = scenes(tmp_path / "scenes", cover=(15, 25, False), **{f"scene[{PLANTED}]": (8, 8, True)})
    made = with_scenes(inputs, items, tmp_path / "made")
    owner = top_of(text_of(made["owner"]))
    assert "cover: 15 of 25 photos could be placed" in owner
    assert "<strong>8 of 8</strong>" in owner
    assert f"scene[{PLANTED}]: 8" not in owner, "nothing is amiss there"
    public = top_of(text_of(made["public"]))
    assert '<span class="label">Photos placed</span> <strong>15 of 25</strong>' in public
    assert "8 of 8" not in public
    assert "cover" not in public


def test_pictures_that_were_not_read_stand_at_the_top(inputs: dict, tmp_path: Path) -> None:
    facts = {"unread": {".heic": 30}}
    lineage = [
        replace(each, facts={**each.facts, **facts}) if each.name == "cover_photos" else each for each in LINEAGE
    ]
    services = Services(lineage=lambda: tuple(lineage))
    made = run_stage(report, ReportParameters(), inputs, tmp_path / "made", services=services)
    assert "cover_photos: 30 pictures (.heic) cannot be read" in top_of(text_of(made["owner"]))
    assert "cannot be read" not in text_of(made["public"])


def test_why_photos_were_left_out_stands_at_the_top(inputs: dict, tmp_path: Path) -> None:
    items = scenes(tmp_path / "scenes", cover=(12, 13, False))
    lineage = [replace(each, facts={**each.facts, "folded": ["p.jpg"]}) for each in LINEAGE]
    services = Services(lineage=lambda: tuple(lineage))
    given = {**inputs, "scenes": tuple(item.artifact for item in items["scenes"])}
    made = run_stage(report, ReportParameters(), given, tmp_path / "made", services=services, items=items)
    assert "1 of them fits no real lens" in top_of(text_of(made["owner"]))
    assert "no real lens" not in text_of(made["public"])


def test_what_crops_all_pictures_stands_at_the_top(inputs: dict, tmp_path: Path) -> None:
    facts = {"shares_shown": [0.4, 0.41, 0.42, 1.0]}
    lineage = [replace(each, facts={**each.facts, **facts}) if each.name == "cover" else each for each in LINEAGE]
    services = Services(lineage=lambda: tuple(lineage))
    made = run_stage(report, ReportParameters(), inputs, tmp_path / "made", services=services)
    said = "The pictures show 41 % of most photos"
    assert f"cover: {said}" in top_of(text_of(made["owner"]))
    assert said not in text_of(made["public"])


def test_the_public_is_not_told_of_a_scene_that_nobody_said_was_private(inputs: dict, tmp_path: Path) -> None:
    """A stage that leads only to private results is left out, whatever its artifact says."""
    items = scenes(tmp_path / "scenes", **{f"photos[{PLANTED}]": (7, 9, False)})
    made = with_scenes(inputs, items, tmp_path / "made")
    assert "7 of 9" in top_of(text_of(made["owner"]))
    assert "7 of 9" not in text_of(made["public"])


def test_a_scene_that_no_photos_were_placed_in_is_passed_over(inputs: dict, tmp_path: Path) -> None:
    """For example, one made by a custom stage."""
    with create(tmp_path / "scene", "scene") as writer:
        writer.write_file("points.txt", "none")
    items = {"scenes": (Item("cover", {}, "cover", load(tmp_path / "scene")),)}
    assert "placed" not in text_of(with_scenes(inputs, items, tmp_path / "made")["owner"])


@pytest.mark.parametrize("legal", [0, 1])
def test_a_message_of_which_no_test_view_is_legal_is_told_at_the_top(tmp_path: Path, legal: int) -> None:
    flags = [replace(row, value=legal * row.value) if row.quantity == "legal" else row for row in PRIVATE_ROWS]
    given = {"scores": (metrics(tmp_path / "scores", PUBLIC_ROWS + flags, True),)}
    made = pages(given, tmp_path / "made")
    told = f"{PLANTED}: The message fills less than 90 % of every test view"
    assert (told in top_of(text_of(made["owner"]))) is (not legal)
    assert "90 %" not in text_of(made["public"])
