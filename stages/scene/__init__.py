"""Cameras, Gaussians, spherical harmonics, capture and scene files, alignment of two scenes."""
