"""The examples in docstrings are correct."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

import opencl
import pipeline
import stages


def modules_with_examples() -> list[str]:
    found = []
    for package in (opencl, pipeline, stages):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            path = Path(*module.name.split("."))
            source = path / "__init__.py" if module.ispkg else path.with_suffix(".py")
            if ">>>" in (Path(__file__).parents[1] / source).read_text():
                found.append(module.name)
    return found


@pytest.mark.parametrize("name", modules_with_examples())
def test_examples(name: str) -> None:
    assert doctest.testmod(importlib.import_module(name)).failed == 0
