"""Parameters that name a module for the stage to load: each file in the package is one more choice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from pipeline.package_modules import folders_of, modules_in


@dataclass(frozen=True)
class ModuleIn:
    """Restricts a text to names of modules directly in a package: `Annotated[str, ModuleIn("stages.methods")]`.

    Any other text is refused, with the same error as if these names were the values of a `Literal`. A stage that loads
    the module must also declare it, with `@stage(modules=…)`.
    """

    package: str

    def names(self) -> list[str]:
        """All these names, sorted. Raises ModuleNotFoundError if the package's parent does not exist."""
        return sorted({name for folder in folders_of(self.package) for name in modules_in(folder)})

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def _checked(self, name: str) -> str:
        names = self.names()
        if name not in names:
            quoted = [f"'{each}'" for each in names]
            expected = " or ".join([", ".join(quoted[:-1]), quoted[-1]] if quoted[1:] else quoted) or "a module"
            raise PydanticCustomError("literal_error", "Input should be {expected}", {"expected": expected})
        return name
