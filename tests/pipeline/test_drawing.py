"""The drawing of a graph is well-formed and has every box and arrow, and no boxes overlap."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.drawing import Box, draw

ROOT = Path(__file__).parents[2]
TIES = """
from itertools import combinations
from pipeline.drawing import Box, draw

ways = [way for way in combinations(range(11), 4) if sum(way) == 20]
sinks = [Box(f"to {way}", tuple(f"from {number}" for number in way)) for way in ways]
print(draw([*(Box(f"from {number}") for number in range(11)), *sinks]))
"""
"""Draws boxes whose neighbours are on average at the same place, but for how their sum is rounded."""
SVG = "{http://www.w3.org/2000/svg}"


@st.composite
def graphs(draw_: st.DrawFn) -> list[Box]:
    count = draw_(st.integers(0, 8))
    boxes: list[Box] = []
    for number in range(count):
        inputs = draw_(st.lists(st.sampled_from(boxes), max_size=3, unique=True)) if boxes else []
        lines = tuple(draw_(st.lists(st.text("ab<&", max_size=20), max_size=2)))
        boxes.append(Box(f"stage {number}", tuple(box.name for box in inputs), lines))
    return boxes


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_every_box_has_its_own_place(boxes: list[Box]) -> None:
    root = ElementTree.fromstring(draw(boxes))
    rectangles = [
        {name: float(rectangle.get(name, "")) for name in ("x", "y", "width", "height")}
        for rectangle in root.iter(f"{SVG}rect")
    ]
    assert len(rectangles) == len(boxes)
    assert len(list(root.iter(f"{SVG}path"))) == sum(len(box.inputs) for box in boxes)
    for a, b in itertools.combinations(rectangles, 2):
        apart = a["x"] + a["width"] < b["x"] or b["x"] + b["width"] < a["x"]
        assert apart or a["y"] + a["height"] < b["y"] or b["y"] + b["height"] < a["y"]
    width, height = float(root.get("width", "")), float(root.get("height", ""))
    for rectangle in rectangles:
        assert 0 <= rectangle["x"] <= width - rectangle["width"]
        assert 0 <= rectangle["y"] <= height - rectangle["height"]


def test_arrows_point_to_the_right() -> None:
    root = ElementTree.fromstring(draw([Box("a"), Box("b", ("a", "elsewhere")), Box("c", ("a", "b"))]))
    left = {text.text: float(text.get("x", "")) for text in root.iter(f"{SVG}text")}
    assert left["a"] < left["b"] < left["c"]


def test_the_drawing_is_the_same_in_every_process() -> None:
    drawings = {
        subprocess.run(
            [sys.executable, "-c", TIES],
            cwd=ROOT,
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("0", "1", "2")
    }
    assert len(drawings) == 1
