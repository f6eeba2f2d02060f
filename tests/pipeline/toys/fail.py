"""Fails in the way that it is told to."""

from __future__ import annotations

import os
import signal
from typing import Literal

from pydantic import Field

from pipeline.errors import CorruptArtifact, UserError
from pipeline.stage import Context, Input, Output, Parameters, stage


class FailParameters(Parameters):
    how: Literal["user", "defect", "death", "silence", "stranger"] = Field("defect", description="In which way.")


@stage(inputs={"numbers": Input("numbers")}, outputs={"numbers": Output("numbers")}, version=1)
def fail(context: Context, parameters: FailParameters) -> None:
    context.log("about to fail")
    if parameters.how == "user":
        raise UserError("no pictures", where="photos/", expected="JPEG or PNG files", remedy="Look there.")
    if parameters.how == "defect":
        raise ZeroDivisionError("division by zero")
    if parameters.how == "stranger":
        raise CorruptArtifact("x\x1b]0;owned\x07.txt: missing")
    if parameters.how == "death":
        with (context.scratch / "attempts").open("a") as attempts:
            attempts.write("x")
        os.kill(os.getpid(), signal.SIGKILL)
