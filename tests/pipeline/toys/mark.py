"""Shifts numbers by an amount that follows from a key, times a level."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage


class MarkParameters(Parameters):
    level: float = Field(1.0, description="By how much. 0: the numbers stay, whatever the key.")


@stage(
    inputs={"numbers": Input("numbers"), "key": Input("numbers")},
    outputs={"numbers": Output("numbers")},
    version=1,
    unread={"key": {"level": 0}},
)
def mark(context: Context, parameters: MarkParameters) -> None:
    shift = parameters.level * context.input("key").read("values").sum() if parameters.level else 0.0
    context.output("numbers").write("values", context.input("numbers").read("values") + shift)
