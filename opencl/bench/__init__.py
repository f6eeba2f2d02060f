"""Benchmarks of the rasterizer against its peers and the limits of the device: `python -m opencl bench`."""
