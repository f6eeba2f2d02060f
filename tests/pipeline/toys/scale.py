"""Multiplies numbers."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage


class ScaleParameters(Parameters):
    factor: float = Field(2.0, description="What the numbers are multiplied by.")


@stage(inputs={"numbers": Input("numbers")}, outputs={"numbers": Output("numbers")}, version=1)
def scale(context: Context, parameters: ScaleParameters) -> None:
    values = context.input("numbers").read("values")
    for done in range(len(values)):
        context.progress(done + 1, len(values), factor=parameters.factor)
    context.log(f"{len(values)} numbers")
    context.output("numbers").write("values", values * parameters.factor)
