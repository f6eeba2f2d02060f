"""The batch's page: a row for each item in order, also for failed ones; the public page has no messages or failures."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.stage import Item, LineageRecord, Services
from stages.imaging.metric_table import MetricRow
from stages.tabulate import TabulateParameters, tabulate
from tests.running import run_stage
from tests.stages.test_report import FORBIDDEN, metrics

PLANTED = "Zebraquartz"
CAUSE = f"message_photos: {PLANTED}/1.png: a picture cannot be read <b>"


def rows(psnr: float, lpips: float | None = None) -> list[MetricRow]:
    measured = [] if lpips is None else [MetricRow("lpips_vgg", lpips, "", "a.png", "test", method="gs_hider")]
    return [
        MetricRow("psnr", psnr, "dB", "a.png", "test", method="gs_hider"),
        MetricRow("psnr", psnr + 2, "dB", "b.png", "test", method="gs_hider"),
        MetricRow("psnr", 99.0, "dB", "c.png", "train", method="gs_hider"),
        *measured,
        MetricRow("gaussians", 1234, method="gs_hider"),
        MetricRow("psnr", psnr + 5, "dB", "a.png", "test", method="plain"),
    ]


def secret_rows(psnr: float) -> list[MetricRow]:
    return [MetricRow("psnr", psnr, "dB", "a.png", "test", PLANTED, method="gs_hider")]


def item(number: int, artifact: Artifact | None, cause: str | None = None) -> Item:
    values = {"cover": f"photos/town{number}", "message": f"photos/{PLANTED}{number}"}
    return Item(f"pair{number}", values, f"scores[{number}]", artifact, cause)


@pytest.fixture
def made(tmp_path: Path) -> dict[str, Artifact]:
    scores = [metrics(tmp_path / f"s{n}", rows(20.0 + n, 0.1) + secret_rows(17.25 + n), private=True) for n in (0, 2)]
    public = [metrics(tmp_path / f"p{n}", rows(20.0 + n, 0.1), private=False) for n in (0, 2)]
    items = {
        "scores": (item(0, scores[0]), item(1, None, CAUSE), item(2, scores[1])),
        "public_scores": (item(0, public[0]), item(1, None, CAUSE), item(2, public[1])),
    }
    lineage = (
        LineageRecord("town", "sfm", 5.0, (), {}, {}, {}, private=False),
        LineageRecord("scores[0]", "evaluate", 1.0, ("town",), {}, {}, {}, private=True),
        LineageRecord("scores[2]", "evaluate", 2.0, ("town",), {}, {}, {}, private=True),
    )
    return run_stage(
        tabulate,
        TabulateParameters(public_columns=("cover",)),
        {"scores": tuple(scores), "public_scores": tuple(public)},
        tmp_path / "out",
        services=Services(lineage=lambda: lineage),
        items=items,
    )


def test_a_row_for_each_item_in_order(made: dict[str, Artifact]) -> None:
    with made["owner"].file("figures.csv").open() as file:
        found = list(csv.DictReader(file))
    assert [row["cover"] for row in found] == ["photos/town0", "photos/town1", "photos/town2"]
    assert [row["cover_psnr"] for row in found] == ["21", "", "23"]
    assert [row["message_psnr"] for row in found] == ["17.25", "", "19.25"]
    assert [row["reference_psnr"] for row in found] == ["25", "", "27"]
    assert [row["seconds"] for row in found] == ["6", "", "7"]
    assert [row["failed"] for row in found] == ["", CAUSE, ""]
    page = made["owner"].file("report.html").read_text()
    assert re.findall(r"photos/town(\d)</th>", page) == ["0", "1", "2"]
    assert "2 of 3 made, 1 failed." in page
    assert "a picture cannot be read &lt;b&gt;" in page
    means = page[page.index("Mean of 2") :]
    assert re.findall(r"<td[^>]*>([^<]*)</td>", means) == ["22.00", "0.100", "18.25", "26.00", "1,234", "6.5 s"]


def test_only_the_owner_is_told_what_the_results_of_a_row_are_called(made: dict[str, Artifact]) -> None:
    """Paths do not say it: one that is long or has blanks is called by its last part and a hash."""
    with made["owner"].file("figures.csv").open() as file:
        assert [row["Item"] for row in csv.DictReader(file)] == ["scores[0]", "scores[1]", "scores[2]"]
    page = made["owner"].file("report.html").read_text()
    assert re.findall(r'<tr><th scope="row">([^<]*)</th>', page) == ["scores[0]", "scores[1]", "scores[2]"]
    public = made["public"].file("report.html").read_text()
    assert "scores[" not in public
    assert "Item" not in public


def test_rows_say_how_many_photos_of_their_scenes_were_placed(tmp_path: Path) -> None:
    scores = [metrics(tmp_path / f"s{n}", rows(20.0 + n), private=True) for n in (0, 2)]
    scenes = []
    for number in range(2):
        with create(tmp_path / f"scene{number}", "scene") as writer:
            writer.attributes.update(registered=40 + number, total=50)
        scenes.append(Item(f"scene{number}", {}, f"cover[{number}]", load(tmp_path / f"scene{number}"), None))
    lineage = (
        *(LineageRecord(f"cover[{n}]", "sfm", 5.0, (), {}, {}, {}, private=False) for n in range(2)),
        LineageRecord("scores[0]", "evaluate", 1.0, ("cover[1]",), {}, {}, {}, private=True),
        LineageRecord("scores[2]", "evaluate", 2.0, (), {}, {}, {}, private=True),
    )
    page = run_stage(
        tabulate,
        TabulateParameters(),
        {"scores": tuple(scores), "scenes": tuple(each.artifact for each in scenes if each.artifact)},
        tmp_path / "out",
        services=Services(lineage=lambda: lineage),
        items={"scores": (item(0, scores[0]), item(2, scores[1])), "scenes": tuple(scenes)},
    )
    owners = page["owner"].file("report.html").read_text()
    assert re.findall(r"<td[^>]*>(cover 41 of 50|–)</td>", owners) == ["cover 41 of 50", "–"]
    assert "of 50" not in page["public"].file("report.html").read_text()


def test_the_public_page_tells_of_no_message_and_no_failure(made: dict[str, Artifact]) -> None:
    assert made["owner"].private
    assert not made["public"].private
    assert made["public"].files == ("report.html",)
    page = made["public"].file("report.html").read_text()
    said = page.replace("between features of VGG16", "").casefold()
    for word in (*FORBIDDEN, "fail", "cause", "18.25", "17.25", "photos/"):
        assert word.casefold() not in said, word
    assert re.findall(r"town(\d)</th>", page) == ["0", "2"]
    assert "25.00" in page


def owners_page(folder: Path, *scored: list[MetricRow]) -> str:
    scores = tuple(metrics(folder / f"s{number}", rows, private=True) for number, rows in enumerate(scored))
    items = tuple(item(number, each) for number, each in enumerate(scores))
    made = run_stage(tabulate, TabulateParameters(), {"scores": scores}, folder / "out", items={"scores": items})
    return made["owner"].file("report.html").read_text()


def test_messages_that_hardly_any_view_shows_are_told(tmp_path: Path) -> None:
    """Their figures are good without meaning much: most of each picture is black."""

    def scored(legal: float) -> list[MetricRow]:
        seen = MetricRow("legal", legal, "", "a.png", "test", PLANTED, method="gs_hider")
        other = MetricRow("legal", 1, "", "a.png", "test", "another message", method="gs_hider")
        return rows(20.0) + secret_rows(26.0) + [seen, other]

    page = owners_page(tmp_path, scored(1), scored(0))
    [told] = re.findall(r'<p class="remark">([^<]*)</p>', page)
    assert told.startswith(f"photos/town1 · photos/{PLANTED}1: The message fills less than 90 % of every test view")


def test_a_mean_says_of_how_many_rows_it_is(tmp_path: Path) -> None:
    page = owners_page(tmp_path, rows(20.0, 0.1), rows(22.0))
    means = re.findall(r"<td[^>]*>([^<]*)</td>", page[page.index("Mean of 2") :])
    assert means[:2] == ["22.00", "0.100 (of 1)"]


def test_a_failed_item_that_is_no_row_has_the_name_of_its_stage(tmp_path: Path) -> None:
    made = metrics(tmp_path / "s", rows(20.0), private=True)
    items = (Item("first", {}, "first", made, None), Item("second", {}, "second", None, CAUSE))
    out = run_stage(tabulate, TabulateParameters(), {"scores": (made,)}, tmp_path / "out", items={"scores": items})
    page = out["owner"].file("report.html").read_text()
    assert re.findall(r'<th scope="row">([^<]*)</th>', page) == ["first", "second"]


def test_scenes_are_numbered_where_no_column_is_public(tmp_path: Path) -> None:
    artifact = metrics(tmp_path / "p", rows(20.0), private=False)
    given = {"scores": (), "public_scores": (item(4, artifact),)}
    inputs = {"scores": (), "public_scores": (artifact,)}
    page = run_stage(tabulate, TabulateParameters(), inputs, tmp_path / "out", items=given)["public"]
    assert '<th scope="row">1</th>' in page.file("report.html").read_text()


def test_scenes_whose_folders_have_the_same_name_are_numbered(tmp_path: Path) -> None:
    """A scene that several rows share is one, and nothing else of its path is public."""
    artifact = metrics(tmp_path / "p", rows(20.0), private=False)
    covers = ("captures/c0/images", "captures/c1/images", "captures/c0/images", "captures/reef")
    items = tuple(Item(str(n), {"cover": cover}, f"scores[{n}]", artifact) for n, cover in enumerate(covers))
    given = {"scores": (), "public_scores": items}
    inputs = {"scores": (), "public_scores": (artifact,) * len(items)}
    parameters = TabulateParameters(public_columns=("cover",))
    page = run_stage(tabulate, parameters, inputs, tmp_path / "out", items=given)["public"].file("report.html")
    found = re.findall(r'<th scope="row">([^<]*)</th>', page.read_text())
    assert found == ["images 1", "images 2", "images 1", "reef"]
    assert "capture" not in page.read_text()


def test_a_batch_that_failed_altogether_has_a_page(tmp_path: Path) -> None:
    given = {"scores": (item(0, None, CAUSE), item(1, None, CAUSE)), "public_scores": ()}
    out = run_stage(tabulate, TabulateParameters(), {"scores": ()}, tmp_path / "out", items=given)
    page = out["owner"].file("report.html").read_text()
    assert "0 of 2 made, 2 failed." in page
    assert page.count("failed: message_photos") == 2


def test_the_bytes_are_the_same_each_time(made: dict[str, Artifact], tmp_path: Path) -> None:
    artifact = metrics(tmp_path / "s", rows(20.0), private=True)
    digests = {
        run_stage(
            tabulate,
            TabulateParameters(),
            {"scores": (artifact,)},
            tmp_path / name,
            items={"scores": (item(0, artifact),)},
        )["owner"].digest
        for name in ("one", "two")
    }
    assert len(digests) == 1
