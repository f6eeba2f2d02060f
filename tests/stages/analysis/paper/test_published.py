"""The paper's figures: each is in the paper, and the paper's contradictions are known."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import ValidationError
from ruamel.yaml import YAML

from stages.analysis.paper.published import FILE, Published, average, read_published, row_of, wrong_averages

PAPER = Path(__file__).parents[5] / "shared" / "paper" / "gs-hider.tex"
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?")


def test_averages_are_the_means_of_their_rows_but_for_four() -> None:
    """To the last digit. A fifth exception would be a typing error in the file; one fewer, a figure made to fit."""
    assert [(name, found, round(mean, 5)) for name, found, mean in wrong_averages(read_published())] == [
        ("Fidelity, gs_hider, message", 25.179, 25.17844),
        ("Single image, gs_hider, cover", 26.44, 26.43522),
        ("All metrics, cover, lpips", 0.246, 0.24544),
        ("All metrics, message, lpips", 0.306, 0.30544),
    ]


def test_tables_that_say_the_same_agree() -> None:
    tables = read_published()
    assert tables.single_image["plain"].cover == tables.fidelity["plain"].cover
    for subject in ("cover", "message"):
        once, again = row_of(tables, "gs_hider", subject, "psnr"), tables.all_metrics[subject]["psnr"]
        assert once is not None
        assert max(abs(a - b) for a, b in zip(once, again, strict=True)) < 0.0011
    for name, variants in tables.ablations.items():
        [usual] = [variant for variant in variants if variant.value == tables.setup[name]]
        assert usual.cover["psnr"] == average(tables.fidelity["gs_hider"].cover)
        assert usual.message["psnr"] == average(tables.fidelity["gs_hider"].message)
    image = tables.traceable_watermark["without"]
    assert image == {
        "cover": average(tables.single_image["gs_hider"].cover),
        "message": average(tables.single_image["gs_hider"].message),
    }
    assert set(tables.messages) == set(tables.captures)


def test_what_the_text_says_follows_from_the_tables() -> None:
    tables = read_published()
    plain = average(tables.fidelity["plain"].cover)
    assert plain - average(tables.no_message["psnr"]) == pytest.approx(0.68, abs=1e-9)
    assert plain - average(tables.single_image["gs_hider"].cover) == pytest.approx(0.765, abs=1e-9)
    assert 1 / average(tables.seconds_per_frame["gs_hider"]) == pytest.approx(45, abs=0.5)


def test_figures_by_capture() -> None:
    tables = read_published()
    assert tables.figure(tables.fidelity["sh"].message, "photos/Kitchen") == 22.758
    assert math.isnan(tables.figure(tables.fidelity["sh"].message, "fox"))
    assert math.isnan(tables.figure(None, "kitchen"))
    assert row_of(tables, "gs_hider", "message", "lpips_vgg") == tables.all_metrics["message"]["lpips"]
    assert row_of(tables, "gs_hider", "message", "lpips_alex") is None
    assert row_of(tables, "sh", "cover", "ssim") is None


def test_a_row_that_lacks_a_figure_is_refused() -> None:
    document = YAML(typ="safe", pure=True).load(FILE)
    document["no_message"]["psnr"].pop()
    with pytest.raises(ValidationError, match="9 figures; expected one for each of 9 captures, and their average"):
        Published.model_validate(document)


@pytest.mark.skipif(not PAPER.is_file(), reason="the paper is not in the project")
def test_every_row_stands_in_the_paper_digit_by_digit() -> None:
    """The numbers of each line of the file are printed one after the other in the paper."""
    tex = re.sub(r"\\cellcolor\{\w+\}|\[1\.5pt\]", "", PAPER.read_text())
    lines = [NUMBER.findall(line) for line in tex.splitlines()]
    checked = 0
    for sequence in _sequences(FILE.read_text()):
        assert any(_contains(line, sequence) for line in lines), sequence
        checked += 1
    assert checked > 40


def _sequences(text: str) -> Iterator[list[str]]:
    """The numbers of each line of the file's tables; for a variant of a setting, without the setting's value."""
    for line in text[text.index("fidelity:") : text.index("# Not of the paper")].splitlines():
        numbers = [] if line.lstrip().startswith("#") else NUMBER.findall(line)
        if "value:" in line:
            yield numbers[1:]  # `test_variants_belong_to_their_values` checks which value it belongs to
        elif numbers:
            yield numbers


def _contains(line: list[str], sequence: list[str]) -> bool:
    return any(line[start : start + len(sequence)] == sequence for start in range(len(line)))


@pytest.mark.skipif(not PAPER.is_file(), reason="the paper is not in the project")
def test_variants_belong_to_their_values() -> None:
    tex = re.sub(r"\\cellcolor\{\w+\}|\\%", "", PAPER.read_text())
    lines = [[float(number) for number in NUMBER.findall(line)] for line in tex.splitlines()]
    tables = read_published()
    for variants in (*tables.ablations.values(), *tables.pruning.values()):
        for variant in variants:
            assert [variant.value, *variant.cover.values(), *variant.message.values()] in lines


@pytest.mark.skipif(not PAPER.is_file(), reason="the paper is not in the project")
def test_hidden_scenes_are_those_of_the_paper() -> None:
    text = PAPER.read_text().replace("\t", " ")
    [covers] = re.findall(r"Original Scene & (.*)\\\\ \\hline", text)
    [hidden] = re.findall(r"Hidden Scene & (.*)\\\\ \\bottomrule", text)
    names = [[name.strip().casefold() for name in row.split("&")] for row in (covers, hidden)]
    assert dict(zip(*names, strict=True)) == dict(read_published().messages)


def test_a_capture_is_the_papers_by_its_folders_name() -> None:
    assert read_published().has("360_v2/Garden")
    assert not read_published().has("garden/fox")
