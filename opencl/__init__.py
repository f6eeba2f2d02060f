"""A Gaussian rasterizer in OpenCL, forward and backward, for features of any dimension."""
