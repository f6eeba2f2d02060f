"""What methods there are: the files in `methods/`."""

from __future__ import annotations

from typing import Annotated

from pipeline.module_names import ModuleIn

PACKAGE = "stages.hiding.methods"

PLAIN = "plain"
"""3DGS without a message: what splats, references and clean models are of."""

MethodName = Annotated[str, ModuleIn("stages.hiding.methods")]
"""One more file there is one more method. Said in full, as shells complete it from the source alone."""


def method_names() -> list[str]:
    """Those of all methods, sorted."""
    return ModuleIn(PACKAGE).names()


def module_of(name: str) -> str:
    """The module that holds method `name`: what a stage declares to the code fingerprint."""
    return f"{PACKAGE}.{name}"
