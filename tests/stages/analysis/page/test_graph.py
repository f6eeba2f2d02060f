from __future__ import annotations

import re

from pipeline.stage import LineageRecord
from stages.analysis.page.graph import Graph, draw_graph


def record(name: str, *inputs: str) -> LineageRecord:
    return LineageRecord(name, "some_stage", 3.0, inputs, {}, {}, {}, False)


def ends(graph: Graph) -> list[tuple[float, float, float, float]]:
    """Where each curve starts and ends."""
    found = []
    for curve in graph.curves:
        x0, y0, *_, x1, y1 = map(float, re.findall(r"-?[\d.]+", curve.split(" h")[0]))
        onward = float(curve.split(" h")[1]) if " h" in curve else 0
        found.append((x0, y0, x1 + onward, y1))
    return found


def test_nothing_was_made() -> None:
    assert draw_graph([]) is None


def test_each_stage_stands_right_of_all_that_it_takes_from() -> None:
    graph = draw_graph([record("a"), record("b", "a"), record("c"), record("d", "b", "c"), record("e", "a", "d")])
    assert graph is not None
    across = {box.full_name: box.x for box in graph.boxes}
    assert across["a"] == across["c"] < across["b"] < across["d"] < across["e"]
    corners = [(box.x, box.y) for box in graph.boxes]
    for x, y in corners:
        assert 0 <= x <= graph.width - graph.box_width
        assert 0 <= y <= graph.height - graph.box_height
    for index, (x, y) in enumerate(corners):
        for other_x, other_y in corners[:index]:
            assert abs(x - other_x) >= graph.box_width or abs(y - other_y) >= graph.box_height


def test_curves_join_what_was_taken_and_run_behind_no_box() -> None:
    graph = draw_graph([record("a"), record("b", "a"), record("c", "b"), record("d", "a", "c", "c"), record("e", "a")])
    assert graph is not None
    middle = {box.full_name: box.y + graph.box_height / 2 for box in graph.boxes}
    left = {box.full_name: box.x for box in graph.boxes}
    starts = {(round(x, 1), round(y, 1)) for x, y, _, _ in ends(graph)}
    stops = {(round(x, 1), round(y, 1)) for _, _, x, y in ends(graph)}
    for name in "abc":
        assert (round(left[name] + graph.box_width, 1), round(middle[name], 1)) in starts
    for name in "bcde":
        assert (round(left[name], 1), round(middle[name], 1)) in stops
    for curve in graph.curves:
        if " h" in curve:  # a lane across a column
            y = float(re.findall(r"-?[\d.]+", curve.split(" h")[0])[-1])
            column = float(re.findall(r"-?[\d.]+", curve.split(" h")[0])[-2])
            assert all(abs(middle[name] - y) > graph.box_height / 2 for name in middle if abs(left[name] - column) < 1)
    assert len(graph.curves) == len(set(graph.curves)) == 7  # three of them along the lane from a to d


def test_long_names_are_shortened_and_kept_in_full() -> None:
    graph = draw_graph([record("a_very_long_name_of_a_stage[with_an_item]")])
    assert graph is not None
    [box] = graph.boxes
    assert box.full_name == "a_very_long_name_of_a_stage[with_an_item]"
    assert box.name.endswith("…")
    assert len(box.name) == 26
