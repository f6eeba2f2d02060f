"""The command line, on a pretended GPU: `python -m tests.workflows.pretended_gpu_run run WORKFLOW --serial …`.

A process of its own, as the pretence needs. Stages run in it (`--serial`).
"""

from __future__ import annotations

from opencl import routes
from tests.pretended_gpu import pretend_gpu, pretending

GPU = pretend_gpu()
routes.working_device = lambda: GPU  # before stages import it

from pipeline.cli import main  # noqa: E402

if __name__ == "__main__":
    with pretending():
        main()
