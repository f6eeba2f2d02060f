"""Says that it began, and in which process, then waits until a gate is opened."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
from pydantic import Field

from pipeline.errors import Interrupted
from pipeline.stage import Context, Output, Parameters, stage


class GateParameters(Parameters):
    folder: str = Field(description="Where the file `open` opens the gate, and `<label>` holds the process's number.")
    label: str = Field(description="The name of this one.")


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def gate(context: Context, parameters: GateParameters) -> None:
    folder = Path(parameters.folder)
    aside = folder / f".{parameters.label}"
    aside.write_text(str(os.getpid()))
    aside.replace(folder / parameters.label)
    while not (folder / "open").exists():
        if context.stop_requested():
            raise Interrupted
        time.sleep(0.02)
    context.record(process=os.getpid())
    context.output("numbers").write("values", np.zeros(1))
