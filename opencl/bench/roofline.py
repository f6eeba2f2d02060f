"""What each kernel has to do, whatever its schedule: operations that the mathematics needs, bytes that must move once.

An addition, a multiplication, a comparison, a division and a square root count as one operation, an exponential as ten
(a polynomial and the scaling). Bytes are those of single precision: each input that the kernel needs read once from
memory, each result written once; what a schedule reads again or keeps aside is its own affair. N Gaussians, V visible,
E (tile, Gaussian) pairs, P contributing (pixel, Gaussian) pairs, X pixels, M features.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from opencl.bench.counts import Counts
from opencl.bench.limits import Limits

_NUMBER = 4
"""Bytes of a float32 or int32."""
_RECORD = 8
"""Numbers that describe a Gaussian on the screen: centre, three of its shape, opacity, reach, depth."""
_GEOMETRY = 11
"""Numbers of a Gaussian beside its features: mean 3, quaternion 4, scales 3, opacity 1."""

_PROJECT = 190
"""World to camera 18, quaternion to matrix 42, camera times matrix 45, Jacobian and scales 30, covariance and
determinant 30, centre, reach, borders and radius 25."""
_PROJECT_BACKWARD = 380
"""`_PROJECT`'s first four once more (135), and about two for each: gradients of scales 40, of the Jacobian and the
rotation 90, of the mean 30, of the quaternion 85."""
_ALPHA = 22
"""Of a pair: offset 2, exponent 7, exponential 10, opacity, clamp and threshold 3."""
_BLEND = 4
"""Of a pair: weight, transmittance after it, its threshold."""
_ALPHA_BACKWARD = 28
"""Of a pair: what is left behind it and the gradient of alpha 6, of exponent and opacity 4, of centre and shape 12,
sums of these six over the pixels 6."""


@dataclass(frozen=True)
class Work:
    """The least that a kernel has to do."""

    operations: float
    bytes: float


def _project(c: Counts) -> Work:
    read, written = _GEOMETRY + c.feature_dim, _RECORD + 4  # and two of the centre, radius, depth key
    return Work(_PROJECT * c.gaussians, _NUMBER * c.gaussians * (read + written))


def _sort(c: Counts) -> Work:
    return Work(0, _NUMBER * 2 * c.gaussians)  # keys in, order out


def _count_tiles(c: Counts) -> Work:
    return Work(0, _NUMBER * c.visible * (_RECORD + 1))  # records in, each one's tiles out


def _fill_tiles(c: Counts) -> Work:
    return Work(0, _NUMBER * (c.visible * (_RECORD + 1) + c.tile_pairs))  # records and order in, lists out


def _blend(c: Counts) -> Work:
    read = c.tile_pairs + c.visible * (_RECORD + c.feature_dim)
    return Work(
        c.contributing * (_ALPHA + _BLEND + 2 * c.feature_dim), _NUMBER * (read + c.pixels * (c.feature_dim + 1))
    )


def _blend_backward(c: Counts) -> Work:
    """Two products with the features, one for the gradient of alpha and one for their own."""
    read = c.tile_pairs + c.visible * (_RECORD + c.feature_dim) + 2 * c.pixels * (c.feature_dim + 1)
    written = c.tile_pairs * (6 + c.feature_dim)  # a row for each tile that a Gaussian is drawn in
    return Work(c.contributing * (_ALPHA + _BLEND + _ALPHA_BACKWARD + 4 * c.feature_dim), _NUMBER * (read + written))


def _sum_gradients(c: Counts) -> Work:
    read, written = c.tile_pairs * (6 + c.feature_dim), c.gaussians * (6 + c.feature_dim)
    return Work(read, _NUMBER * (read + written))


def _project_backward(c: Counts) -> Work:
    return Work(_PROJECT_BACKWARD * c.visible, _NUMBER * (c.visible * (_GEOMETRY - 1 + 6) + c.gaussians * _GEOMETRY))


_WORK: dict[str, Callable[[Counts], Work]] = {
    "project": _project,
    "sort_by_depth": _sort,
    "count_tiles": _count_tiles,
    "fill_tiles": _fill_tiles,
    "blend": _blend,
    "blend_backward": _blend_backward,
    "sum_gradients": _sum_gradients,
    "project_backward": _project_backward,
}


@dataclass(frozen=True)
class KernelShare:
    """A kernel's time in a forward and backward pass, and how near to the device's limits it comes."""

    kernel: str
    seconds: float
    arithmetic: float | None
    """Fraction of the device's operations a second; None where it is not known what the kernel has to do."""
    bandwidth: float | None
    """Fraction of the device's bytes a second; above 1 where what it needs is still in a cache."""


def kernel_share(kernel: str, seconds: float, counts: Counts, limits: Limits) -> KernelShare:
    """Of a kernel that took so many seconds to draw one picture."""
    formula = _WORK.get(kernel)
    if formula is None:
        return KernelShare(kernel, seconds, None, None)
    work = formula(counts)
    return KernelShare(
        kernel, seconds, work.operations / seconds / limits.flops, work.bytes / seconds / limits.bandwidth
    )
