"""Libraries whose versions may change the bits of a training, and of other stages that process many pictures."""

from __future__ import annotations

LIBRARIES = ("torch", "numpy", "pyopencl", "opencv-contrib-python-headless")
"""Package names; a checkpoint that was written with other versions is reported."""
