"""Records the modes of all it writes while it writes: artifacts, checkpoints, and files that libraries make."""

from __future__ import annotations

import json
import tempfile

import numpy as np

from pipeline.stage import Context, Output, Parameters, stage
from tests.pipeline.durability.toys.told import tell


class SpreadParameters(Parameters):
    """No parameters."""


@stage(
    inputs={},
    outputs={"hidden": Output("numbers", "private"), "shown": Output("numbers", "public")},
    version=1,
)
def spread(context: Context, parameters: SpreadParameters) -> None:
    for name in ("hidden", "shown"):
        writer = context.output(name)
        writer.write("group/values", np.arange(10.0))
        writer.path_for("deep/note.txt").write_text("a note")
        tempfile.mkstemp(dir=writer.path)
    (context.scratch / "checkpoint").write_text("half")
    roots = (context.scratch, context.output("hidden").path)
    files = [path for root in roots for path in (root, *root.rglob("*"))]
    above = context.output("hidden").path.parent
    tell(json.dumps({str(path): oct(path.stat().st_mode & 0o777) for path in [*files, above, above.parent]}))
