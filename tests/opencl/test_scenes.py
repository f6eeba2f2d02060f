"""Tests of `near_a_threshold`: it finds the pixels that comparisons must leave out, and few others."""

from __future__ import annotations

import math

from tests.opencl.scenes import make_scene, near_a_threshold, one_gaussian


def test_pixels_at_the_smallest_alpha_are_found():
    flat = (0.2, 0.2, 0.0)  # so that its size does not depend on where it is
    variance = (20 * 0.2 / 2) ** 2 + 0.3
    offset = math.sqrt(2 * variance * math.log(0.5 * 255))  # where alpha is exactly 1/255
    near = near_a_threshold(one_gaussian(centre=((4.5 - offset) / 10, 0.05, 2.0), scales=flat, opacity=0.5))
    assert near[9, 14]
    assert near.sum() < 5


def test_few_pixels_of_a_scene_are_left_out():
    assert near_a_threshold(make_scene()).double().mean() < 0.2
