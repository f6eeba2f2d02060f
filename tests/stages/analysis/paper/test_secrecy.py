"""The chapter on secrecy: what attackers see beside what the owner sees, verdicts that can fail, and plain words."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.stage import Item
from stages.analysis.measurements import KIND, Measurement, write_measurements
from stages.analysis.paper.runs import Experiment
from stages.analysis.paper.secrecy_figures import Kind, noise_of
from stages.analysis.paper.secrecy_figures import measured as measured_of
from stages.analysis.paper.secrecy_relations import secrecy_relations
from stages.analysis.secrecy.conditions import (
    BLIND,
    CHANNEL,
    CHANNELS,
    COVER_ITSELF,
    IGNORED,
    LINEAR,
    NOTHING_HIDDEN,
    OPEN,
    OTHER_START,
    OWN_START,
    OWNER,
    PAINTED,
    RANDOM,
    SURROGATE,
    VIEWS_SEEN,
)
from stages.compare_with_paper import CompareWithPaperParameters, compare_with_paper
from tests.running import run_stage
from tests.stages.test_compare_with_paper import table

FLOOR, OWNERS = 15.0, 25.0
SHARES = {0.01: 1, 0.2: 9}
NAME = "zebraquartz"


def reading(
    condition: str, psnr: float, related: float, severity: float | None = None, seed: int | None = None
) -> list[Measurement]:
    figures = {
        "psnr_covered": psnr,
        "psnr_constant": FLOOR,
        "psnr_coloured": psnr + 1,
        "correlation": related,
        "correlation_others": 0.25,
    }
    return [
        Measurement(quantity, value + offset, condition, severity, seed, view, "test", NAME)
        for view, offset in (("0.png", -0.01), ("8.png", 0.01))
        for quantity, value in figures.items()
    ]


def rows_of(feature_dim: int, leaks: float) -> list[Measurement]:
    """A surrogate exceeds one colour by `leaks` dB with a fifth of the views, by half as much with a single one."""
    rows = reading(OWNER, OWNERS, 0.95) + reading(COVER_ITSELF, 9.0, 0.3)
    for seed in range(3):
        rows += reading(RANDOM, 6.0 + seed, 0.3, seed=seed) + reading(OTHER_START, 8.0, 0.3, seed=seed)
        for share, views in SHARES.items():
            psnr = FLOOR + leaks * (1.0 if share > 0.1 else 0.5) + 0.1 * (seed - 1)
            rows += reading(SURROGATE, psnr, 0.5 + leaks / 20, share, seed) + reading(LINEAR, FLOOR, 0.4, share, seed)
            rows.append(Measurement(VIEWS_SEEN, views, SURROGATE, share, seed))
    rows += reading(OWN_START, 7.0, 0.6, seed=0)
    rows += reading(BLIND.format(IGNORED), 11.5, 0.5, 0.0)
    rows += reading(NOTHING_HIDDEN.format(BLIND.format(IGNORED)), 10.0, 0.31, 0.0)
    for quantity, value in (
        ("correlation_cover", 0.9),
        ("correlation", 0.2 + 1 / feature_dim),
        ("correlation_others", 0.2),
    ):
        rows.append(Measurement(quantity, value, CHANNEL.format(1), None, None, "0.png", "test", NAME))
    return rows


def item(
    folder: Path, method: str, feature_dim: int, rows: Sequence[Measurement], capture: str = "fox", **stated: object
) -> Item:
    label = "_".join(map(str, (capture, method, feature_dim, *stated.values())))
    with create(folder / label, KIND, private=True) as writer:
        write_measurements(writer, rows)
    values = {"cover": capture, "method": method, "feature_dim": feature_dim, "seed": 0, **stated}
    return Item(label, values, f"secrecy[{label}]", load(folder / label))


def compared(folder: Path, *items: Item) -> dict[str, Artifact]:
    return run_stage(
        compare_with_paper,
        CompareWithPaperParameters(tables=("secrecy",), capture_column="cover"),
        {"experiments": tuple(each.artifact for each in items if each.artifact)},
        folder / "page",
        items={"experiments": items},
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Artifact]:
    folder = tmp_path_factory.mktemp("secrecy")
    items = (
        item(folder, "gs_hider", 32, rows_of(32, 2.0)),
        item(folder, "gs_hider", 8, rows_of(8, 6.0)),
        item(folder, "sh", 16, reading(OWNER, 18.0, 0.8) + reading(OPEN, 18.0, 0.8)),
    )
    return compared(folder, *items)


def markdown(made: dict[str, Artifact]) -> str:
    return made["owner"].file("tables.md").read_text(encoding="utf-8")


def test_charts_stand_beside_the_markdown_which_shows_them(made: dict[str, Artifact]) -> None:
    shown = re.findall(r"!\[[^]]*\]\((.*?)\)", markdown(made))
    assert [file for file in made["owner"].files if file.endswith(".svg")] == shown
    assert len(shown) == 1
    assert "Correlation with the message" in made["owner"].file(shown[0]).read_text(encoding="utf-8")


def test_wrong_decoders_stand_beside_the_owners(made: dict[str, Artifact]) -> None:
    found = table(markdown(made), "Decoders that are not the owner's, fox, test views: the message over its pixels")
    assert next(iter(found)) == ("3DGS+SH", OWNER, "here")
    assert found["GS-Hider, M = 8", RANDOM, "here"] == {
        "PSNR (dB)": "7.00 ± 1.00 (n = 3)",
        "vs. one colour": "-8.00",
        "Best of them": "8.00",
        "Correlation": "0.300 (n = 3)",
        "With other views": "0.250",
    }
    assert found["GS-Hider, M = 8", OWN_START, "here"]["Best of them"] == "–", "it is the only one"
    assert found["GS-Hider, M = 8", RANDOM, "paper"]["PSNR (dB)"] == "a picture only"
    assert found["GS-Hider, M = 32", OWNER, "here"]["vs. one colour"] == "+10.00"


def test_surrogates_are_a_curve_over_what_leaked(made: dict[str, Artifact]) -> None:
    found = table(markdown(made), "Attackers with some of the message's views, fox, test views: the message (dB)")
    line = found["GS-Hider, M = 8", "decoder, trained"]
    assert (line["0 %"], line["1%, 1 view"], line["20%, 9 views"]) == ("", "18.00 ± 0.10", "21.00 ± 0.10")
    assert (line["Owner"], line["One colour"]) == ("25.00", "15.00")
    coloured = found["GS-Hider, M = 8", "decoder, trained, in true colours"]
    assert coloured["0 %"] == "12.50 (r = 0.50 (0.25))"
    assert found["3DGS+SH", "decoder, trained"]["0 %"] == "18.00"
    page = made["owner"].file("report.html").read_text(encoding="utf-8")
    for title in ("The message as the best surrogate shows it", "Correlation with the message"):
        assert title in page
    for share in ("1%", "20%"):
        assert f"Does small M leak more? The best surrogate with {share} of the views" in page


def test_curves_are_those_of_the_best_surrogate_whichever_it_is(tmp_path: Path) -> None:
    """Ours, sealed, shows a trained decoder nothing, and the message to whoever paints the leaked views."""
    drawn = []
    for weak, strong in ((SURROGATE, PAINTED), (PAINTED, SURROGATE)):
        rows = reading(OWNER, OWNERS, 0.95)
        for share in SHARES:
            rows += reading(weak, FLOOR - 1, 0.5, share, 0) + reading(strong, FLOOR + 20 * share, 0.8, share, 0)
            rows.append(Measurement(VIEWS_SEEN, SHARES[share], SURROGATE, share, 0))
        made = compared(tmp_path / weak, item(tmp_path / weak, "homogeneous", 16, rows))
        [file] = [file for file in made["owner"].files if file.endswith(".svg")]
        drawn.append(made["owner"].file(file).read_text(encoding="utf-8"))
    assert drawn[0] == drawn[1]
    assert "polyline" in drawn[0]


def test_verdicts_can_fail(made: dict[str, Artifact]) -> None:
    found = {names[1]: cells for names, cells in table(markdown(made), "Relations on test views").items()}
    verdicts = {name: cells["Verdict"] for name, cells in found.items()}
    over = "message over one colour"
    assert verdicts[f"3DGS+SH: {over}, public attributes"] == "does not hold"
    assert verdicts[f"GS-Hider, M = 8: {over}, the best random decoder"] == "holds"
    assert verdicts[f"GS-Hider, M = 8: {over}, the best surrogate with 20% of the views"] == "does not hold"
    assert verdicts[f"GS-Hider, M = 32: {over}, the best surrogate with 1% of the views"] == "holds, within noise"
    small = "GS-Hider: M = 8 leaks more than 32, by the best surrogate's gap to the owner's decoder, 20% of the views"
    assert found[small]["Average"] == "+4.00 dB"
    assert verdicts[small] == "holds"
    blind = "GS-Hider, M = 8: message over the cover itself, both in true colours, the best blind reading"
    assert found[blind]["fox"] == "+2.50 dB"


@pytest.mark.parametrize(("apart", "verdict"), [(0.3, "holds"), (0.1, "holds, within noise")])
def test_noise_of_small_features_is_that_of_surrogates_alone(tmp_path: Path, apart: float, verdict: str) -> None:
    """Three seeds each, a tenth of a decibel apart: the noise of the difference of two such means is 0.08 dB."""
    items = (
        item(tmp_path, "gs_hider", 32, rows_of(32, 2.0)),
        item(tmp_path, "gs_hider", 8, rows_of(8, 2.0 + apart)),
    )
    page = compared(tmp_path, *items)
    small = "GS-Hider: M = 8 leaks more than 32, by the best surrogate's gap to the owner's decoder, 20% of the views"
    found = {names[1]: cells for names, cells in table(markdown(page), "Relations on test views").items()}
    assert found[small]["Average"] == f"+{apart:.2f} dB"
    assert found[small]["Verdict"] == verdict


def experiment(capture: str, rows: Sequence[Measurement]) -> Experiment:
    return Experiment(capture, "gs_hider", "0", tuple(rows), {"feature_dim": 8})


def darkened(*conditions: str) -> list[Measurement]:
    """Measurements in which these readings show 10 dB less of the message."""
    return [
        replace(row, value=row.value - 10)
        if row.quantity in ("psnr_covered", "psnr_coloured") and row.condition in conditions
        else row
        for row in rows_of(8, 2.0)
    ]


def test_what_shows_most_on_one_capture_need_not_do_so_on_another() -> None:
    """On the fox a decoder learns most of the views, on bonsai it fails, and least squares shows one colour."""
    other = reading(BLIND.format(CHANNELS), 5.0, 0.3, 0.0)
    fox = experiment("fox", rows_of(8, 6.0) + other)
    bonsai = experiment("bonsai", darkened(SURROGATE, BLIND.format(IGNORED)) + other)
    relations = {each.text: each.measured for each in secrecy_relations({Kind("gs_hider", 8.0): [fox, bonsai]})}
    over = "GS-Hider, M = 8: message over "
    surrogate = relations[f"{over}one colour, the best surrogate with 20% of the views"]
    assert [surrogate.on(capture) for capture in ("fox", "bonsai")] == pytest.approx([6, 0])
    blind = relations[f"{over}the cover itself, both in true colours, the best blind reading"]
    assert [blind.on(capture) for capture in ("fox", "bonsai")] == pytest.approx([2.5, -4])


def test_what_leaks_on_one_capture_leaks_however_little_it_does_on_others() -> None:
    dark = darkened(SURROGATE, LINEAR, RANDOM, BLIND.format(IGNORED))
    leaking = [replace(row, value=row.value + 12) if row.condition == RANDOM else row for row in rows_of(8, 6.0)]
    both = {Kind("gs_hider", 8.0): [experiment("fox", leaking), experiment("bonsai", dark)]}
    verdicts = {relation.text: relation for relation in secrecy_relations(both)}
    over = "GS-Hider, M = 8: message over "
    for reading in (
        "one colour, the best random decoder",
        "one colour, the best surrogate with 20% of the views",
        "the cover itself, both in true colours, the best blind reading",
    ):
        assert verdicts[over + reading].value < 1 < verdicts[over + reading].measured.on("fox"), reading
        assert not verdicts[over + reading].is_found, reading


def test_one_colour_has_no_noise() -> None:
    """With deviations of 0.1 dB, the mean of three surrogates is sure to 0.25 dB; the difference of two to 0.35."""
    found = secrecy_relations({Kind("gs_hider", 8.0): [experiment("fox", rows_of(8, 0.7))]})
    [relation] = [relation for relation in found if "the best surrogate with 20%" in relation.text]
    assert (relation.value, relation.verdict) == (pytest.approx(0.7), "holds")


def test_what_is_not_secure_is_said_in_words(made: dict[str, Artifact]) -> None:
    text = markdown(made)
    assert "3DGS+SH keeps nothing secret: the published file alone shows the message at 18.00 dB." in text
    assert "60% with 20% of them (r = 0.80, control 0.25)" in text
    assert "anyone with just the container: three channels" in text
    assert "show the message (r = 0.50, control 0.31)" in text
    assert "anyone who guesses the seed of a training without a key" in text


def test_of_surrogates_the_one_that_shows_most_is_judged(tmp_path: Path) -> None:
    """An attacker with leaked views paints with them if a decoder would learn less."""
    rows = rows_of(8, 2.0)
    for seed in range(3):
        rows += reading(PAINTED, FLOOR + 7.0, 0.9, 0.2, seed)
    page = compared(tmp_path, item(tmp_path, "homogeneous", 8, rows))
    text = markdown(page)
    assert "70% with 20% of them (r = 0.90, control 0.25)" in text
    found = {names[1]: cells for names, cells in table(text, "Relations on test views").items()}
    [relation] = [cells for name, cells in found.items() if "the best surrogate with 20%" in name]
    assert (relation["fox"], relation["Verdict"]) == ("+7.00 dB", "does not hold")


def test_small_features_leak_by_whichever_reader_shows_most(tmp_path: Path) -> None:
    """Painting shows more of the large container than the trained decoder does, and comes nearer to its owner's."""
    large = rows_of(32, 2.0)
    for seed in range(3):
        large += reading(PAINTED, FLOOR + 7.0, 0.9, 0.2, seed)
    page = compared(
        tmp_path, item(tmp_path, "homogeneous", 32, large), item(tmp_path, "homogeneous", 8, rows_of(8, 6.0))
    )
    found = {names[1]: cells for names, cells in table(markdown(page), "Relations on test views").items()}
    [small] = [cells for name, cells in found.items() if "leaks more" in name and "20% of the views" in name]
    assert (small["Average"], small["Verdict"]) == ("-1.00 dB", "does not hold")


def test_with_a_single_test_view_other_controls_are_enough(tmp_path: Path) -> None:
    rows = [
        replace(row, value=math.nan) if row.quantity == "correlation_others" else row
        for row in rows_of(8, 6.0)
        if row.view != "8.png"
    ]
    each = item(tmp_path, "gs_hider", 8, rows)
    made = compared(tmp_path, each)
    text = markdown(made)
    assert "show the message (r = 0.49, control 0.30)" in text
    assert "60% with 20% of them (r = 0.79, control 0.29)" in text
    assert "anyone who guesses the seed of a training without a key" in text


def test_captures_count_alike_however_many_views_they_have(tmp_path: Path) -> None:
    few = [replace(row, value=row.value + 0.01) for row in rows_of(8, 2.0) if row.view != "8.png"]
    more = [replace(row, value=row.value + 4) if row.quantity == "psnr_covered" else row for row in rows_of(8, 2.0)]
    made = compared(tmp_path, item(tmp_path, "gs_hider", 8, few), item(tmp_path, "gs_hider", 8, more, "bonsai"))
    found = table(
        markdown(made), "Decoders that are not the owner's, fox, bonsai, test views: the message over its pixels"
    )
    assert found["GS-Hider, M = 8", OWNER, "here"]["PSNR (dB)"] == "27.00"
    assert found["GS-Hider, M = 8", RANDOM, "here"]["Best of them"] == "10.00"
    assert found["GS-Hider, M = 8", RANDOM, "here"]["PSNR (dB)"] == "9.00 ± 0.71 (n = 3)"


def test_the_noise_of_one_run_does_not_shrink_with_more_captures(tmp_path: Path) -> None:
    """Each capture has seeds of its own; averaging over captures before taking deviations would halve it twice."""
    captures = ("fox", "bonsai", "kitchen", "garden")
    shaken = []
    for number, capture in enumerate(captures):
        rows = [
            replace(row, value=row.value + (1 if (row.seed + number) % 2 else -1))
            if row.condition == SURROGATE and row.quantity == "psnr_covered" and row.seed is not None
            else row
            for row in rows_of(8, 2.0)
        ]
        shaken.append(Experiment(capture, "gs_hider", "0", tuple(rows), {"feature_dim": 8}))
    for count in (1, 4):
        spreads = measured_of(shaken[:count], "psnr_covered", SURROGATE, 0.2)
        assert noise_of(spreads).deviation == pytest.approx(1.155, abs=0.2)
        assert noise_of(spreads).freedom == 2 * count


def test_the_reading_that_is_farthest_beyond_chance_is_told_of(tmp_path: Path) -> None:
    """It has fewer decibels than another reading, whose correlation is that of chance."""
    rows = reading(OWNER, OWNERS, 0.95) + reading(COVER_ITSELF, 9.0, 0.3)
    rows += reading(BLIND.format(CHANNELS), 12.0, 0.32, 0.0) + reading(BLIND.format(IGNORED), 11.5, 0.8, 0.0)
    text = markdown(compared(tmp_path, item(tmp_path, "gs_hider", 16, rows)))
    assert f"(reading {IGNORED!r}) show the message (r = 0.80, control 0.30)" in text


def test_containers_of_another_weight_have_lines_of_their_own(tmp_path: Path) -> None:
    made = compared(
        tmp_path,
        item(tmp_path, "gs_hider", 16, rows_of(16, 2.0), lambda_message=0.5),
        item(tmp_path, "gs_hider", 16, rows_of(16, 6.0), lambda_message=0.25),
        item(tmp_path, "gs_hider", 8, rows_of(8, 4.0), lambda_message=0.25),
    )
    found = table(markdown(made), "Attackers with some of the message's views, fox, test views: the message (dB)")
    at_most = {names[0]: cells["20%, 9 views"] for names, cells in found.items() if names[1] == "decoder, trained"}
    assert at_most == {
        "GS-Hider, M = 16": "17.00 ± 0.10",
        "GS-Hider, M = 8, λ = 0.25": "19.00 ± 0.10",
        "GS-Hider, M = 16, λ = 0.25": "21.00 ± 0.10",
    }
    relations = [names[1] for names in table(markdown(made), "Relations on test views")]
    assert sum("leaks more than" in text for text in relations) == 2, "8 against 16 of one weight, by two shares"


def test_the_feature_map_has_its_controls(made: dict[str, Artifact]) -> None:
    caption = "What the feature map shows as it is, fox, test views: absolute correlations"
    found = table(markdown(made), caption)
    assert found["GS-Hider, M = 8", "channel 1"]["Message"] == "0.325"
    assert not any("nothing hidden" in name for names in found for name in names), "it stands in a column"
    assert found["GS-Hider, M = 8", BLIND.format(IGNORED)] == {
        "Cover": "–",
        "Message": "0.500",
        "Other views' message": "0.250",
        "Nothing hidden": "0.310",
    }


def test_every_figure_has_its_digits_and_nothing_is_public(made: dict[str, Artifact]) -> None:
    rows = list(csv.DictReader(io.StringIO(made["owner"].file("figures.csv").read_text(encoding="utf-8"))))
    assert any(row["line"].endswith(RANDOM) and row["n"] == "3" for row in rows)
    assert made["public"].files == ()


def test_without_measurements_nothing_is_shown(tmp_path: Path) -> None:
    page = run_stage(compare_with_paper, CompareWithPaperParameters(tables=("secrecy",)), {}, tmp_path)["owner"]
    assert "None of this was measured." in page.file("tables.md").read_text(encoding="utf-8")
