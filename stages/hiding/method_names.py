"""The available methods: the files in `methods/`."""

from __future__ import annotations

from typing import Annotated

from pipeline.module_names import ModuleIn

PACKAGE = "stages.hiding.methods"

PLAIN = "plain"
"""3DGS without a message: the method of splats, references and clean models."""

MethodName = Annotated[str, ModuleIn("stages.hiding.methods")]
"""The name of a file in `methods/`. The package is spelled out since shell completion parses the source only."""


def method_names() -> list[str]:
    """The names of all methods, sorted."""
    return ModuleIn(PACKAGE).names()


def module_of(name: str) -> str:
    """The module of method `name`, which a stage declares for its code fingerprint."""
    return f"{PACKAGE}.{name}"
