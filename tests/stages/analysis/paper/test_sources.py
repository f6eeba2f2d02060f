"""Every page ends with the artifacts its figures come from, and the public page reveals no private name there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.stage import Item
from stages.analysis.measurements import Measurement, write_measurements
from stages.analysis.picture_classes import HIDDEN
from stages.analysis.stegexpose.fusion import DETECTORS, FUSION
from stages.compare_with_paper import CompareWithPaperParameters, compare_with_paper
from stages.imaging.metric_table import MetricRow
from tests.running import run_stage
from tests.stages.analysis.paper import synthetic
from tests.stages.test_report import Reader

TITLE = "Where the figures come from"
MESSAGE = "Zebraquartz"


def detected(folder: Path) -> Item:
    """A detector's measurements, from a stage that the workflow itself named."""
    with create(folder / "detected", "measurements", private=True) as writer:
        write_measurements(writer, [Measurement(name, 0.5, HIDDEN, method="gs_hider") for name in (*DETECTORS, FUSION)])
    name = f"own_detector[fox,{MESSAGE}]"
    return Item("fox", {"capture": "fox", "method": "gs_hider"}, name, load(folder / "detected"))


@pytest.fixture(scope="module")
def items(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Item, ...]]:
    folder = tmp_path_factory.mktemp("items")
    scores = []
    for seed in (0, 1):
        rows = synthetic.scene_rows("fox", "gs_hider", seed, messages=[MESSAGE])
        values = {"capture": "fox", "method": "gs_hider", "message": MESSAGE, "seed": seed}
        artifact = synthetic.metrics(folder, f"scores_{seed}", rows)
        scores.append(Item(f"fox_{seed}", values, f"scores[fox,{MESSAGE},{seed}]", artifact))
    values = {"capture": "fox", "method": "gs_hider"}
    seconds = synthetic.metrics(folder, "times", [MetricRow("seconds_per_frame", 0.02, "s")], private=False)
    return {
        "scores": (*scores, Item("late", {"capture": "fox"}, "scores[late]", None, "no memory")),
        "public_scores": tuple(synthetic.public_of(folder, scores)),
        "timings": (Item("fox", values, f"timings[fox,{MESSAGE}]", seconds),),
        "experiments": (detected(folder),),
    }


@pytest.fixture(scope="module")
def made(items: dict[str, tuple[Item, ...]], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Artifact]:
    return run_stage(
        compare_with_paper,
        CompareWithPaperParameters(tables=("fidelity", "steganalysis")),
        {name: tuple(item.artifact for item in given if item.artifact) for name, given in items.items()},
        tmp_path_factory.mktemp("pages") / "out",
        workflow_name="fidelity",
        items=items,
    )


def section(artifact: Artifact) -> tuple[list[tuple[str, ...]], str]:
    """The lines of the table at the end of the Markdown page, and the note below it."""
    text = artifact.file("tables.md").read_text(encoding="utf-8").replace("\\", "")
    _, table, note = text[text.index(f"## {TITLE}") :].strip().split("\n\n")[1:]
    return [tuple(cell.strip() for cell in line.strip("|").split(" | ")) for line in table.splitlines()[2:]], note


def digests(items: tuple[Item, ...]) -> list[str]:
    return [item.artifact.digest[:12] for item in items if item.artifact is not None]


def test_the_owners_page_names_every_artifact(items: dict[str, tuple[Item, ...]], made: dict[str, Artifact]) -> None:
    """Each under its name in the workflow, without failed ones, and how to show it; folded on the HTML page."""
    expected = [
        (item.stage, item.artifact.digest[:12])
        for name in ("scores", "timings", "experiments")
        for item in items[name]
        if item.artifact is not None
    ]
    lines, note = section(made["owner"])
    assert lines == expected
    assert "`python -m pipeline show DIGEST --all --reveal`" in note
    page = made["owner"].file("report.html").read_text(encoding="utf-8")
    folded = page[page.index(f"<h2>{TITLE}</h2>") :]
    assert re.search(r"<details>.*</details>", folded, re.DOTALL)
    for name, digest in expected:
        assert name in folded
        assert digest in folded
    reader = Reader()
    reader.feed(page)
    assert not reader.open


def test_a_page_names_the_stages_of_its_own_workflow(made: dict[str, Artifact]) -> None:
    """And not those of another workflow."""
    text = made["owner"].file("tables.md").read_text(encoding="utf-8").replace("\\", "")
    assert "score of every picture: see the measurements of own_detector." in text


def test_the_public_page_names_public_artifacts_by_its_own_words(
    items: dict[str, tuple[Item, ...]], made: dict[str, Artifact]
) -> None:
    """A stage's name may contain that of a message, and digests of private artifacts concern nobody else."""
    lines, note = section(made["public"])
    scores, [times] = digests(items["public_scores"]), digests(items["timings"])
    assert lines == [
        *(("3DGS" if number == 0 else "", "1", digest) for number, digest in enumerate(scores)),
        *(("This scene" if number == 0 else "", "1", digest) for number, digest in enumerate((*scores, times))),
    ]
    assert "--reveal" not in note
    for file in made["public"].files:
        text = made["public"].file(file).read_text(encoding="utf-8")
        assert MESSAGE not in text
        assert not [digest for digest in digests((*items["scores"], *items["experiments"])) if digest in text]


def test_a_page_of_nothing_has_no_such_section(tmp_path: Path) -> None:
    failed = Item("fox", {"capture": "fox"}, "scores[fox]", None, "no memory")
    pages = run_stage(
        compare_with_paper, CompareWithPaperParameters(), {"scores": ()}, tmp_path / "out", items={"scores": (failed,)}
    )
    for file in ("tables.md", "report.html"):
        assert TITLE not in pages["owner"].file(file).read_text(encoding="utf-8")
