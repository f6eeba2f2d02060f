"""Checkpoints of trainings, and of other stages that process many pictures."""

from __future__ import annotations

import torch

from opencl.routes import describe_drawing
from pipeline.checkpoint import Checkpoints
from pipeline.stage import Context

LIBRARIES = ("torch", "numpy", "pyopencl", "opencv-contrib-python-headless")
"""Package names; their versions may change the bits of a result."""


def checkpoints_on(context: Context, device: torch.device) -> Checkpoints:
    """The checkpoints of a stage that works on `device`. One of another device or other versions is reported."""
    return Checkpoints(context, LIBRARIES, {"device": describe_drawing(device)})
