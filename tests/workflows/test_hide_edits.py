"""The workflow that hides edits of the cover: its settings reach the edits, and the edited scenes are private."""

from __future__ import annotations

from pathlib import Path

from pipeline.console.project import open_project

WORKFLOW = Path(__file__).parents[2] / "workflows" / "hide_edits.yaml"


def test_settings_reach_the_edits_and_edits_are_private(tmp_path: Path, store: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    (photos / "a.jpg").write_bytes(b"1")
    settings = [f"cover={photos}", "hue=75", "object_width=0.3"]
    nodes = open_project(WORKFLOW, store, settings).graph.nodes
    (recolour,) = nodes["recoloured"].parameters["edits"]
    (remove,) = nodes["without_object"].parameters["edits"]
    assert recolour["hue"] == 75
    assert remove["region"]["size"] == [0.3, 0.3, 0.26]
    assert {name for name, node in nodes.items() if node.private} >= {"recoloured", "without_object"}
    assert not nodes["plain"].private
    for name in ("recoloured_views", "without_object_views"):
        assert "message" not in nodes[name].sources or not nodes[name].sources["message"]
        assert nodes[name].parameters["placement"] == "same_world"
