"""Writes down some of its environment variables."""

from __future__ import annotations

import json
import os

from pipeline.stage import Context, Output, Parameters, stage


class EnvironmentParameters(Parameters):
    """No parameters."""


@stage(inputs={}, outputs={"page": Output("report")}, version=1)
def environment(context: Context, parameters: EnvironmentParameters) -> None:
    names = ("OMP_NUM_THREADS", "OMP_WAIT_POLICY", "POCL_CACHE_DIR")
    context.output("page").write_file("report.html", json.dumps({name: os.environ.get(name) for name in names}))
