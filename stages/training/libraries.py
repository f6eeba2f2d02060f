"""Libraries whose versions may change the bits of a training, and of what looks at many pictures."""

from __future__ import annotations

LIBRARIES = ("torch", "numpy", "pyopencl", "opencv-contrib-python-headless")
"""By their packages' names: a checkpoint that was written with other versions is told of."""
