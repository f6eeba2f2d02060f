"""Adds up what the `grow` stages made."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage
from tests.pipeline.durability.toys.told import tell


class GatherParameters(Parameters):
    seed: int = Field(-1, description="Only to tell one from another.")


@stage(inputs={"numbers": Input("numbers", many=True)}, outputs={"numbers": Output("numbers")}, version=1)
def gather(context: Context, parameters: GatherParameters) -> None:
    tell("begin", parameters.seed, 0)
    arrays = context.input_many("numbers")
    for name in arrays[0].names:
        context.output("numbers").write(name, sum(artifact.read(name) for artifact in arrays), chunks=(5000,))
    tell("end", parameters.seed)
