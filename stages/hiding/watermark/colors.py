"""The colours in which grain is added and searched for."""

from __future__ import annotations

import torch

LUMINANCE, GRAIN, ACROSS = range(3)
"""Rows of `COLORS`."""


def _colors() -> torch.Tensor:
    luminance = torch.nn.functional.normalize(torch.tensor([0.299, 0.587, 0.114]), dim=0)
    red = torch.tensor([0.5, -0.25, 0.1])
    grain = torch.nn.functional.normalize(red - luminance * (luminance @ red), dim=0)
    return torch.stack([luminance, grain, torch.linalg.cross(luminance, grain)])


COLORS = _colors()
"""Three orthonormal directions of sRGB: luminance; the grain's, between red and cyan; and the remaining colour
direction.

At the finest scale, camera pictures and renders are far smoother in colour than in luminance, so that grain in colour
stands out to its reader and less to the eye. Luminance can be read as well (fox, one level: standard scores of 30 to
67, where this colour has 31 to 64) and survives downscaling better, but not JPEG (quality 50: scores down to -1, where
this colour's fall to 11)."""
