"""Crashes as a driver would, or stays in a library call."""

from __future__ import annotations

import ctypes
import os
from typing import Literal

from pydantic import Field

from pipeline.stage import Context, Output, Parameters, stage
from tests.pipeline.durability.toys.told import tell


class CrashParameters(Parameters):
    how: Literal["abort", "segment", "library", "never"] = Field("never", description="In which way.")


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def crash(context: Context, parameters: CrashParameters) -> None:
    context.log("about to crash")
    tell("crash", os.getpid())
    if parameters.how == "abort":
        os.abort()
    if parameters.how == "segment":
        ctypes.string_at(0)
    if parameters.how == "library":
        ctypes.PyDLL(None).sleep(600)  # holds the interpreter's lock, unlike CDLL
    context.output("numbers").write_file("done.txt", "done")
