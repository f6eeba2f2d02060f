"""A chapter's charts as SVG: every chart and name is there, all inside the picture, and names are not markup."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest

from stages.analysis.page.chart import Chart, Series, line_chart
from stages.analysis.paper.drawing import drawing_file, write_drawing

NAMES = ("3DGS+SH", "GS-Hider", "<script> & more")


def chart(title: str, lines: int) -> Chart:
    series = [Series(name, ((30.0, 20.0), (31.0, 22.0 + place))) for place, name in enumerate(NAMES[:lines])]
    made = line_chart(title, series, from_zero=False, axes=("cover (dB)", "message (dB)"))
    assert made is not None
    return made


def texts(drawing: str) -> list[str]:
    return [element.text or "" for element in ElementTree.fromstring(drawing).iter("{http://www.w3.org/2000/svg}text")]


@pytest.mark.parametrize("count", [1, 3, 4, 7])
def test_every_chart_has_a_place_of_its_own_within_the_picture(count: int) -> None:
    drawing = write_drawing("Robustness", [chart(f"attack {number}", 1 + number % 3) for number in range(count)])
    found = texts(drawing)
    assert [text for text in found if text.startswith("attack")] == [f"attack {number}" for number in range(count)]
    root = ElementTree.fromstring(drawing)
    width, height = float(root.get("width", 0)), float(root.get("height", 0))
    places = [tuple(map(float, place)) for place in re.findall(r"<g transform=\"translate\((\d+) (\d+)\)\">", drawing)]
    panels = places[::2]
    assert len(set(panels)) == count
    assert all(x + 420 <= width and y + 300 + 18 <= height for x, y in panels)


def test_the_longest_legend_of_a_row_pushes_the_next_row_down() -> None:
    short = write_drawing("", [chart("a", 1)] * 4)
    long = write_drawing("", [chart("a", 1), chart("a", 3), chart("a", 1), chart("a", 1)])
    rows = [re.findall(r"<g transform=\"translate\(24 (\d+)\)\">", drawing)[-1] for drawing in (short, long)]
    assert int(rows[1]) - int(rows[0]) == 2 * 18


def test_a_long_title_is_broken_and_pushes_every_chart_down() -> None:
    long = "All together: renders that hide, against renders that do not"
    drawings = [write_drawing("", [chart(title, 1), chart("b", 1)]) for title in ("a", long)]
    assert [text for text in texts(drawings[1]) if text in long] == [
        "All together: renders that hide, against",
        "renders that do not",
    ]
    insides = [re.findall(r"<g transform=\"translate\(0 (\d+)\)\">", drawing) for drawing in drawings]
    assert [[int(lower) - int(upper) for upper, lower in zip(*insides, strict=True)]] == [[18, 18]]
    heights = [float(ElementTree.fromstring(drawing).get("height", 0)) for drawing in drawings]
    assert heights[1] - heights[0] == 18


def test_names_are_text_and_never_markup() -> None:
    drawing = write_drawing("a & b", [chart("<b>", 3)])
    assert "<script>" not in drawing
    assert {"<b>", "<script> & more", "cover (dB) →", "message (dB) ↑"} <= set(texts(drawing))


def test_the_files_name_is_the_chapters() -> None:
    assert drawing_file("Robustness") == "robustness.svg"
    assert drawing_file("../What a “decoder” shows") == "what_a_decoder_shows.svg"


def test_more_lines_than_colours_look_different_in_drawing_and_legend_alike() -> None:
    series = [Series(f"method {number}", ((30.0, 20.0), (31.0, 22.0 + number))) for number in range(14)]
    made = line_chart("many", series)
    assert made is not None
    root = ElementTree.fromstring(write_drawing("", [made]))
    drawn, named = (
        [element.get("class", "") for element in root.iter(f"{{http://www.w3.org/2000/svg}}{kind}")]
        for kind in ("polyline", "line")
    )
    assert len(set(drawn)) == 14
    assert [look for look in named if look.startswith("line")] == drawn
    style = next(root.iter("{http://www.w3.org/2000/svg}style")).text or ""
    assert all(f".{name} " in style for name in {*" ".join(drawn).split()} - {"dashes0"})
