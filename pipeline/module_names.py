"""A text among a stage's parameters that names a module, which the stage then loads: a file more is a choice more."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from pipeline.package_modules import modules_in


@dataclass(frozen=True)
class ModuleIn:
    """Marks a text as the name of a module directly in a package: `Annotated[str, ModuleIn("stages.methods")]`.

    Any other is refused as one that is none of the values of a `Literal` is. A stage that loads the module declares it
    besides, by `@stage(modules=…)`.
    """

    package: str

    def names(self) -> list[str]:
        """All such names, sorted. Raises ModuleNotFoundError where there is nothing that the package could lie in."""
        found = importlib.util.find_spec(self.package)
        folders = (found.submodule_search_locations if found else None) or []
        return sorted({name for folder in folders for name in modules_in(Path(folder))})

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def _checked(self, name: str) -> str:
        names = self.names()
        if name not in names:
            quoted = [f"'{each}'" for each in names]
            expected = " or ".join([", ".join(quoted[:-1]), quoted[-1]] if quoted[1:] else quoted) or "a module"
            raise PydanticCustomError("literal_error", "Input should be {expected}", {"expected": expected})
        return name
