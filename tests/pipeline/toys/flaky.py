"""Fails a few times with an error that may pass; counts its attempts in its scratch directory."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from pipeline.errors import TransientError
from pipeline.stage import Context, Output, Parameters, stage


class FlakyParameters(Parameters):
    failures: int = Field(1, ge=0, description="How often it fails.")


@stage(inputs={}, outputs={"numbers": Output("numbers")}, version=1)
def flaky(context: Context, parameters: FlakyParameters) -> None:
    attempts = context.scratch / "attempts"
    done = len(attempts.read_text()) if attempts.exists() else 0
    attempts.write_text("x" * (done + 1))
    if done < parameters.failures:
        raise TransientError("the connection broke off")
    context.output("numbers").write("values", np.zeros(1))
