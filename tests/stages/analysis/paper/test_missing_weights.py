"""If the weights of one LPIPS network are missing, its columns say so, and the page names what to install."""

from __future__ import annotations

import pytest

from stages.analysis.paper.ablations import ablations
from stages.analysis.paper.chapter import LPIPS, Writer
from stages.analysis.paper.fidelity import fidelity
from stages.analysis.paper.no_message import no_message
from stages.analysis.paper.page import owner_page
from stages.analysis.paper.published import read_published
from stages.analysis.paper.runs import Run, Study
from stages.analysis.paper.several_messages import several_messages
from stages.analysis.paper.single_image import single_image
from stages.imaging.lpips_weights import HOW_TO_INSTALL
from tests.stages.analysis.paper.synthetic import image_rows, picture_rows, scene_rows
from tests.stages.analysis.paper.test_message_tables import run, table

NETWORKS = [
    pytest.param("lpips_vgg", "LPIPS", id="VGG16"),
    pytest.param("lpips_alex", "LPIPS (AlexNet)", id="AlexNet"),
]
HIDING = scene_rows("fox", "gs_hider", messages=["reef"])
SEVERAL = scene_rows("fox", "gs_hider", messages=["reef", "library"])
BARE = scene_rows("fox", "gs_hider")
IMAGE = image_rows("fox", "gs_hider", "boat")
LAYERS = [*picture_rows("gs_hider", 24.0), *picture_rows("gs_hider", 21.0, "reef")]


def without(quantity: str, *runs: Run) -> Study:
    """The runs as scored where a network's weights are missing."""
    rows = [tuple(row for row in each.rows if row.quantity != quantity) for each in runs]
    return Study(
        tuple(Run(each.capture, each.method, each.settings, "0", own) for each, own in zip(runs, rows, strict=True))
    )


@pytest.mark.parametrize(("quantity", "label"), NETWORKS)
@pytest.mark.parametrize(
    ("writer", "runs", "caption", "line", "column"),
    [
        (fidelity, [run("gs_hider", HIDING)], "{}, test views", ("GS-Hider", "Message", "here"), "Average"),
        (no_message, [run("gs_hider", BARE)], "Nothing hidden, test views", ("GS-Hider", "{}", "here"), "Average"),
        (
            single_image,
            [run("gs_hider", IMAGE)],
            "One image in one view: {}",
            ("GS-Hider", "Cover · boat", "here"),
            "Average",
        ),
        (
            several_messages,
            [run("gs_hider", SEVERAL)],
            "Several messages, test views: {}",
            ("GS-Hider, 2 messages", "Message 2 · library", "here"),
            "Average",
        ),
        (
            ablations,
            [run("gs_hider", HIDING), run("gs_hider", LAYERS, layers=3.0)],
            "GS-Hider: Layers, test views",
            ("3", "here"),
            "Cover {}",
        ),
    ],
)
def test_a_column_says_that_it_was_not_measured(
    writer: Writer, runs: list[Run], caption: str, line: tuple[str, ...], column: str, quantity: str, label: str
) -> None:
    """Without the column, it would seem that nobody had thought of the metric."""
    chapter = writer(without(quantity, *runs), read_published())
    found = table(chapter, caption.format(label))
    assert found[tuple(name.format(label) for name in line)][column.format(label)] == "not measured"


@pytest.mark.parametrize("quantity", LPIPS)
def test_the_page_names_what_to_install(quantity: str) -> None:
    page = owner_page(without(quantity, run("gs_hider", HIDING)), ["fidelity"], read_published(), "", "")
    [said] = [remark for remark in page.remarks if "not measured" in remark]
    assert said.startswith(f"LPIPS ({LPIPS[quantity]}) was not measured.")
    assert HOW_TO_INSTALL in said


def test_a_page_without_pictures_names_nothing_to_install() -> None:
    page = owner_page(Study(()), ["robustness"], read_published(), "", "")
    assert not [remark for remark in page.remarks if HOW_TO_INSTALL in remark]
