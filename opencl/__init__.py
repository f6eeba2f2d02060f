"""A Gaussian rasterizer in OpenCL, forward and backward, for features of any dimension."""

import os

# Before pyopencl is imported: else it keeps pickles in the user's cache, and fails where there is none to write to.
os.environ.setdefault("PYOPENCL_NO_CACHE", "1")
