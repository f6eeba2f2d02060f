"""The example of a workflow in `workflows/README.md` is valid."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

from pipeline.console.project import open_project
from tests.stages.test_photos import take

WORKFLOWS = Path(__file__).parents[2] / "workflows"


def example_in(text: str) -> str:
    """The workflow that a page shows."""
    (example,) = re.findall(r"^    name: .*?(?=^\S)", text, re.MULTILINE | re.DOTALL)
    return textwrap.dedent(example)


def test_the_example_is_whole(tmp_path: Path, store: Path) -> None:
    example = example_in((WORKFLOWS / "README.md").read_text())
    file = tmp_path / "marked.yaml"
    file.write_text(example)
    take(tmp_path / "photos" / "a.jpg")
    project = open_project(file, store, [f"photos={tmp_path / 'photos'}"])
    assert len(project.graph.nodes) == example.count("uses:")
