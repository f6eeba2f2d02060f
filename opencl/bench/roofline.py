"""The minimum work of each kernel, independent of the schedule: operations required by the mathematics, bytes moved.

An addition, multiplication, comparison, division or square root counts as one operation, an exponential as ten (a
polynomial and the scaling). Bytes are for single precision, with each input of a kernel read from memory once and each
result written once. A schedule's repeated reads and temporary data do not count.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from opencl.bench.counts import Counts
from opencl.bench.limits import Limits

_NUMBER = 4
"""Bytes of a float32 or int32."""
_RECORD = 8
"""Numbers that describe a Gaussian on the screen: centre 2, shape 3, opacity, reach, depth."""
_GEOMETRY = 11
"""Numbers of a Gaussian besides its features: mean 3, quaternion 4, scales 3, opacity 1."""

_PROJECT = 190
"""Per Gaussian: world to camera 18, quaternion to matrix 42, camera times matrix 45, Jacobian and scales 30, covariance
and determinant 30, centre, reach, borders and radius 25."""
_PROJECT_BACKWARD = 380
"""Per Gaussian: the first four terms of `_PROJECT` again (135), and about twice as much for their gradients: of scales
40, of the Jacobian and the rotation 90, of the mean 30, of the quaternion 85."""
_ALPHA = 22
"""Per pair: offset 2, exponent 7, exponential 10, opacity, clamp and threshold 3."""
_BLEND = 4
"""Per pair: weight, transmittance behind it, and its threshold."""
_ALPHA_BACKWARD = 28
"""Per pair: blended remainder behind it and gradient of alpha 6, gradients of exponent and opacity 4, of centre and
shape 12, sums of these six over the pixels 6."""


@dataclass(frozen=True)
class Work:
    """The minimum work of a kernel."""

    operations: float
    bytes: float


def _project(c: Counts) -> Work:
    read, written = _GEOMETRY + c.feature_dim, _RECORD + 4  # also means2d (2), radius, depth key
    return Work(_PROJECT * c.gaussians, _NUMBER * c.gaussians * (read + written))


def _sort(c: Counts) -> Work:
    return Work(0, _NUMBER * 2 * c.gaussians)  # keys in, order out


def _count_tiles(c: Counts) -> Work:
    return Work(0, _NUMBER * c.visible * (_RECORD + 1))  # records in, tile counts out


def _fill_tiles(c: Counts) -> Work:
    return Work(0, _NUMBER * (c.visible * (_RECORD + 1) + c.tile_pairs))  # records and order in, lists out


def _blend(c: Counts) -> Work:
    read = c.tile_pairs + c.visible * (_RECORD + c.feature_dim)
    return Work(
        c.contributing * (_ALPHA + _BLEND + 2 * c.feature_dim), _NUMBER * (read + c.pixels * (c.feature_dim + 1))
    )


def _blend_backward(c: Counts) -> Work:
    """Includes two products with the features: for the gradient of alpha, and for that of the features."""
    read = c.tile_pairs + c.visible * (_RECORD + c.feature_dim) + 2 * c.pixels * (c.feature_dim + 1)
    written = c.tile_pairs * (6 + c.feature_dim)  # one row per (tile, Gaussian) pair
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
    """The time of a kernel in a forward and backward pass, and the fractions of the device's limits it reaches."""

    kernel: str
    seconds: float
    arithmetic: float | None
    """Fraction of the device's peak operations per second. None if the kernel's minimum work is not known."""
    bandwidth: float | None
    """Fraction of the device's peak bandwidth, above 1 if inputs are still in a cache. None as above."""


def kernel_share(kernel: str, seconds: float, counts: Counts, limits: Limits) -> KernelShare:
    """The share of a kernel that took `seconds` for one picture."""
    formula = _WORK.get(kernel)
    if formula is None:
        return KernelShare(kernel, seconds, None, None)
    work = formula(counts)
    return KernelShare(
        kernel, seconds, work.operations / seconds / limits.flops, work.bytes / seconds / limits.bandwidth
    )
