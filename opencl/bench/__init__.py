"""How fast the rasterizer is, against its peers and against what the device can do: `python -m opencl bench`."""
