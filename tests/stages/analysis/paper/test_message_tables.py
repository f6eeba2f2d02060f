"""Chapters other than Table 1 also show all that was measured: every metric, training views, covered pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from stages.analysis.paper.ablations import ablations
from stages.analysis.paper.chapter import Chapter
from stages.analysis.paper.message_tables import Shown, messages_grid
from stages.analysis.paper.no_message import no_message
from stages.analysis.paper.published import read_published
from stages.analysis.paper.runs import Run, Settings, Study
from stages.analysis.paper.several_messages import several_messages
from stages.analysis.paper.single_image import single_image
from stages.imaging.metric_table import MetricRow
from tests.stages.analysis.paper.synthetic import HIDING_VIEW, image_rows, picture_rows, scene_rows


def run(method: str, rows: Sequence[MetricRow], **settings: float) -> Run:
    return Run("fox", method, tuple(settings.items()), "0", tuple(row for row in rows if row.method == method))


def table(chapter: Chapter, caption: str) -> dict[tuple[str, ...], dict[str, str]]:
    """The texts of a table, by the names of a line and the headings."""
    [grid] = [grid for grid in chapter.grids if grid.caption == caption]
    return {
        line.names: dict(zip(grid.headings, (cell.text for cell in line.cells), strict=True)) for line in grid.lines
    }


def test_several_messages_are_shown_by_every_metric() -> None:
    """Each message separately, with its own legal views and covered pixels, and on training views as well."""
    rows = scene_rows("fox", "gs_hider", messages=["reef", "library"])
    study = Study((run("gs_hider", rows), run("plain", rows)))
    chapter = several_messages(study, read_published())
    name, second = "GS-Hider, 2 messages", "Message 2 · library"
    assert {grid.caption for grid in chapter.grids} == {
        *(f"Several messages, test views: {label}" for label in ("PSNR (dB)", "SSIM", "LPIPS", "LPIPS (AlexNet)")),
        "Several messages: legal views and covered pixels, test views",
        "Several messages, training views: PSNR (dB)",
    }
    assert table(chapter, "Several messages, test views: SSIM")[name, second, "here"]["fox"] == "0.839"
    assert table(chapter, "Several messages, test views: LPIPS (AlexNet)")[name, "Cover", "here"]["fox"] == "0.231"
    assert table(chapter, "Several messages, training views: PSNR (dB)")[name, second, "here"]["fox"] == "24.22"
    found = table(chapter, "Several messages: legal views and covered pixels, test views")
    assert found[name, "Message 1 · reef", "fox"]["PSNR, covered (dB)"] == "24.42"
    assert found[name, second, "fox"]["PSNR, covered (dB)"] == "24.02"
    assert found[name, second, "fox"]["Legal views"] == "1 of 2"


def test_captures_that_hide_one_message_alone_are_left_out_of_several() -> None:
    """Plain 3DGS hides nothing on either: its average would be over other captures than those of the methods."""
    rows = scene_rows("fox", "gs_hider", messages=["reef", "library"])
    single = scene_rows("bonsai", "gs_hider", messages=["reef"])
    methods = ("gs_hider", "plain")
    runs = [*(run(method, rows) for method in methods), *(replace(run(m, single), capture="bonsai") for m in methods)]
    chapter = several_messages(Study(tuple(runs)), read_published())
    shown = table(chapter, "Several messages, test views: PSNR (dB)")["3DGS", "Cover", "here"]
    assert shown["Average"] == shown["fox"]
    assert shown.get("bonsai", "–") == "–"


def test_the_papers_figures_without_a_message_are_of_its_own_methods_alone() -> None:
    methods = ("plain", "sh", "gs_hider", "homogeneous")
    runs = [replace(run(method, scene_rows("kitchen", method)), capture="kitchen") for method in methods]
    [grid] = no_message(Study(tuple(runs)), read_published()).grids
    assert {line.names[0] for line in grid.lines} == {"3DGS", "3DGS+SH", "GS-Hider", "Homogeneous GS-Hider"}
    assert {line.names[0] for line in grid.lines if line.published} == {"3DGS", "GS-Hider"}


def test_fewer_messages_come_first() -> None:
    """Whatever the order of the runs: workflows train what takes longest first."""
    names = ["reef", "library", "workshop"]
    runs = [run("gs_hider", scene_rows("fox", "gs_hider", messages=names[:count])) for count in (3, 1, 2)]
    listed = table(several_messages(Study(tuple(runs)), read_published()), "Several messages, test views: SSIM")
    titles = dict.fromkeys(title for title, _, _ in listed)
    assert list(titles) == ["GS-Hider, 1 message", "GS-Hider, 2 messages", "GS-Hider, 3 messages"]


def test_several_messages_with_more_channels_stand_beside_the_usual_ones() -> None:
    names = ["reef", "library"]
    usual = [run("gs_hider", scene_rows("fox", "gs_hider", messages=names[:count])) for count in (1, 2)]
    more: Settings = (("feature_dim", 24.0),)
    larger = [replace(each, settings=more) for each in usual]
    listed = table(several_messages(Study((*larger, *usual)), read_published()), "Several messages, test views: SSIM")
    titles = dict.fromkeys(title for title, _, _ in listed)
    assert {*titles} == {"GS-Hider, 1 message", "GS-Hider, 2 messages", "GS-Hider, M = 24, 2 messages"}


def test_a_method_with_one_message_stands_beside_those_with_several() -> None:
    """It may have failed with more, and says what one costs; captures that hide one message alone are Table 1's."""
    several = run("gs_hider", scene_rows("fox", "gs_hider", messages=["reef", "library"]))
    one = run("homogeneous", scene_rows("fox", "homogeneous", messages=["reef"]))
    elsewhere = replace(run("sh", scene_rows("kitchen", "sh", messages=["reef"])), capture="kitchen")
    chapter = several_messages(Study((several, one, elsewhere)), read_published())
    titles = {title for title, _, _ in table(chapter, "Several messages, test views: SSIM")}
    assert titles == {"GS-Hider, 2 messages", "Homogeneous GS-Hider, 1 message"}
    assert not several_messages(Study((one, elsewhere)), read_published()).grids


def test_sizes_that_are_not_of_all_captures_say_so() -> None:
    """Sizes of different captures cannot be compared."""
    names = ["reef", "library"]
    ours = [run("homogeneous", scene_rows("fox", "homogeneous", messages=names))]
    theirs = [run("gs_hider", scene_rows("fox", "gs_hider", messages=names))]
    theirs.append(replace(run("gs_hider", scene_rows("kitchen", "gs_hider", messages=names)), capture="kitchen"))
    chapter = several_messages(Study((*ours, *theirs)), read_published())
    sizes = {line.names[0]: line.cells[0].note for line in chapter.grids[0].lines if line.names[1] == "Cover"}
    assert sizes == {"Homogeneous GS-Hider, 2 messages": "on 1 capture", "GS-Hider, 2 messages": ""}
    assert chapter.grids[0].headings[0] == "Size (MB)"


def test_a_message_by_itself_has_its_own_legal_views() -> None:
    """All messages together have the sum of theirs."""
    legal = {"reef": 1.0, "library": 0.0}
    rows = [MetricRow("legal", value, "", "0.png", "test", name, None, "gs_hider") for name, value in legal.items()]
    runs = [run("gs_hider", rows)]
    grid = messages_grid(
        "", ("Which",), [Shown(("both",), runs), Shown(("reef",), runs, 0), Shown(("second",), runs, 1)]
    )
    assert [line.cells[0].text for line in grid.lines] == ["1 of 2", "1 of 1", "0 of 1"]


def test_an_image_is_shown_with_the_covers_training_views_and_every_metric() -> None:
    """LPIPS was measured only for the cover on test views, and the table says so."""
    rows = image_rows("fox", "gs_hider", "boat")
    rows.append(MetricRow("ssim", 0.99, "", HIDING_VIEW, "train", "boat", None, "gs_hider"))
    chapter = single_image(Study((run("gs_hider", rows), run("plain", rows))), read_published())
    decibels = table(chapter, "One image in one view: PSNR (dB)")
    assert decibels["GS-Hider", "Cover, training views · boat", "here"]["fox"] == "26.77"
    assert decibels["3DGS", "Cover, training views", "here"]["fox"] == "27.35"
    similar = table(chapter, "One image in one view: SSIM")
    assert similar["GS-Hider", "Image · boat", "here"]["fox"] == "0.990"
    assert similar["GS-Hider", "Cover, the view that hides it · boat", "here"]["fox"] == "0.881"
    perceptual = table(chapter, "One image in one view: LPIPS")
    assert [names[1] for names in perceptual] == ["Cover", "Cover · boat", "Image · boat"]
    assert perceptual["GS-Hider", "Image · boat", "here"]["Average"] == "not measured"
    assert not [names for names in similar if "paper" in names]


@pytest.fixture
def ablated() -> Chapter:
    runs = []
    for layers, gain in ((5.0, 0.0), (3.0, -1.0)):
        rows = [*picture_rows("gs_hider", 25 + gain), *picture_rows("gs_hider", 22 + gain, "kitchen")]
        runs.append(run("gs_hider", rows, **({"layers": layers} if layers != 5 else {})))
    return ablations(Study(tuple(runs)), read_published())


def test_ablations_show_training_views_legal_views_and_covered_pixels(ablated: Chapter) -> None:
    training = table(ablated, "GS-Hider: Layers, training views")
    assert training["3", "here"] == {
        "Cover PSNR (dB)": "24.50",
        "Cover SSIM": "0.850",
        "Message PSNR (dB)": "21.50",
        "Message SSIM": "0.807",
    }
    found = table(ablated, "GS-Hider: Layers, messages: legal views and covered pixels, test views")
    assert found["3", "fox"]["PSNR, covered (dB)"] == "21.30"
    assert found["5", "fox"]["PSNR, covered (dB)"] == "22.30"
    assert found["5", "fox"]["Legal views"] == "1 of 2"
    assert table(ablated, "GS-Hider: Layers, test views")["3", "paper"]["Message PSNR (dB)"]
