"""Benchmarks are run by hand, seldom, and some on machines that are lent for minutes: they have to start."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path

import pytest

import tests.benchmarks
from stages.image import ImageParameters, image
from tests.benchmarks.whole_trainings import Work

ROOT = Path(__file__).parents[2]
NAMES = [each.name for each in pkgutil.iter_modules(tests.benchmarks.__path__) if not each.name.startswith("test_")]


@pytest.mark.parametrize("name", NAMES)
def test_what_it_imports_is_there(name: str) -> None:
    assert importlib.import_module(f"tests.benchmarks.{name}")


def test_a_stage_that_was_interrupted_is_done_again(tmp_path: Path) -> None:
    work = Work(tmp_path, threads=1)
    emblem = ImageParameters(file=ROOT / "workflows" / "images" / "emblem.png")
    (tmp_path / "emblem" / ".image").mkdir(parents=True)
    others = tmp_path / "emblem" / "photo.jpg", tmp_path / "emblem" / ".scratch" / "checkpoint"
    others[1].parent.mkdir()
    for other in others:
        other.touch()
    assert work.done("emblem", image, emblem, {})["image"].kind == "image"
    assert all(other.exists() for other in others)
