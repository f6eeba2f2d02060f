"""Counts as precisely as what is installed allows."""

from __future__ import annotations

import numpy as np
from pydantic import Field, field_validator

from pipeline.data_folder import data_files
from pipeline.stage import Context, Output, Parameters, stage


class EquippedParameters(Parameters):
    precise: bool = Field(True, description="Whether to count as well as can be.")

    @field_validator("precise")
    @classmethod
    def _as_installed(cls, wanted: bool) -> bool:
        return wanted and "instrument" in data_files()


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def equipped(context: Context, parameters: EquippedParameters) -> None:
    context.output("numbers").write("values", np.array([3.14 if parameters.precise else 3.0]))
