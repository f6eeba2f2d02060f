"""Procedural scenes and the ray tracer that photographs them."""
