"""Resamples photos taken through lenses to pictures of one pinhole camera at training size, in one step.

The pinhole is chosen so that every pixel of every picture shows something: no black borders. Photos of one camera
without distortion that are used at their own size are not resampled at all, as in 3DGS: blurring the reference by half
a pixel would add a decibel to the PSNR of renders.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

Project = Callable[[Float64[np.ndarray, "N 3"]], Float64[np.ndarray, "N 2"]]
"""Maps points in camera space to pixel positions; NaN if the lens does not see a point."""
Unproject = Callable[[Float64[np.ndarray, "N 2"]], Float64[np.ndarray, "N 2"]]
"""Maps pixel positions to points on the plane at depth 1; NaN if the lens model has no solution."""

BORDER_SAMPLES = 101
WIDEST_TANGENT = 1.75  # a pinhole of more than 120 degrees would spend its pixels on the corners
SHRINKING, SHRINKINGS = 1.01, 100
WIDE_ENOUGH = 0.8  # fraction by area that pictures must show of most photos; otherwise some photos are left out
FEW = 0.1  # largest fraction of the photos to leave out
FINEST_SAMPLING = 8  # samples per training pixel and axis; larger photos are averaged down to that first


@dataclass(frozen=True)
class LensView:
    """What undistortion needs of a lens: its projection, the inverse, and the photos' size."""

    project: Project
    unproject: Unproject
    width: int
    height: int


@dataclass(frozen=True)
class Pinhole:
    """A camera without distortion whose sides are even; its pixels are square, unless it is the photos' own."""

    intrinsics: Float64[np.ndarray, "3 3"]
    width: int
    height: int


def training_size(size: tuple[int, int], long_side: int) -> tuple[int, int]:
    """Width and height with the proportions of `size`, both even, the longer at most `long_side`; never enlarged.

    Without a reduction, only an odd last row or column is lost.

    >>> training_size((1080, 1920), 240), training_size((779, 520), 192), training_size((1237, 822), 1600)
    ((134, 240), (192, 128), (1236, 822))
    """
    longest = min(long_side, max(size)) // 2 * 2
    if longest == max(size) // 2 * 2:
        return even_sides(size)
    width, height = (max(2, side * longest // max(size) // 2 * 2) for side in size)
    return width, height


def even_sides(size: tuple[int, int]) -> tuple[int, int]:
    """Width and height without an odd last row or column, but at least 2."""
    width, height = (max(2, side // 2 * 2) for side in size)
    return width, height


def own_pinhole(lenses: Sequence[LensView], size: tuple[int, int]) -> Pinhole | None:
    """The camera that took all photos of this width and height, if it is one without distortion; else None.

    Its pictures are the photos, pixel by pixel, but for an odd last row or column. Lenses may be those of resized
    photos. None without lenses.
    """
    width, height = even_sides(size)
    for lens in lenses[:1]:
        (left, top), (right, bottom) = lens.unproject(np.array([[0.0, 0.0], [lens.width, lens.height]]))
        if right > left and bottom > top and min(size) > 1:
            focal = np.array(size) / (right - left, bottom - top)
            x, y = -focal * (left, top)
            pinhole = Pinhole(np.array([[focal[0], 0, x], [0, focal[1], y], [0, 0, 1]]), width, height)
            return pinhole if all(takes_pixels_as_they_are(each, pinhole, size) for each in lenses) else None
    return None


def takes_pixels_as_they_are(lens: LensView, pinhole: Pinhole, size: tuple[int, int]) -> bool:
    """Whether the pinhole's pixels coincide with the photo's, up to a thousandth of a pixel."""
    scale = np.array(size) / (lens.width, lens.height)
    own = np.stack(np.meshgrid(np.arange(pinhole.width + 1), np.arange(pinhole.height + 1)), axis=-1)
    return bool((np.abs(corner_positions(lens, pinhole) * scale - own) <= 1e-3).all())  # NaN is not


def shared_pinhole(lenses: Sequence[LensView], width: int, height: int) -> Pinhole:
    """The widest pinhole camera of this size whose every pixel lies inside the photos of all lenses.

    If the lenses' fields of view differ, it sees what all of them see. Raises `ValueError` if they have no field of
    view in common, or fold over within it.
    """
    left, top, right, bottom = common_rectangle(lenses)
    if not (right > left and bottom > top):
        raise ValueError(
            "the lenses of these photos have no field of view in common; make a capture of each lens's photos, or "
            "correct the lenses in the file of poses"
        )
    focal = focal_within((left, top, right, bottom), width, height)
    middle = np.array([left + right, top + bottom]) / 2
    for _ in range(SHRINKINGS):
        x, y = np.array([width, height]) / 2 - focal * middle
        pinhole = Pinhole(np.array([[focal, 0, x], [0, focal, y], [0, 0, 1]]), width, height)
        if all(sees_whole_pinhole(lens, pinhole) for lens in lenses):
            return pinhole
        focal *= SHRINKING
    raise ValueError(
        "the lenses of these photos fold over: their distortion is not that of a real lens; correct it in the file of "
        "poses, or take that file out of the folder to have the lenses estimated"
    )


def folded_lenses(lenses: Sequence[LensView], width: int, height: int) -> list[int]:
    """Numbers of the lenses that fold over or cannot be inverted, if that leaves no pinhole for all; else empty.

    Real lenses do not; those estimated for something that no lens took, such as a phone's panorama, may.
    """
    if _have_pinhole(lenses, width, height):
        return []
    return [number for number, lens in enumerate(lenses) if not _have_pinhole([lens], width, height)]


def _have_pinhole(lenses: Sequence[LensView], width: int, height: int) -> bool:
    try:
        shared_pinhole(lenses, width, height)
    except ValueError:
        return False
    return True


def shares_shown(lenses: Sequence[LensView], width: int, height: int) -> tuple[float, ...]:
    """The fraction, by area, that the shared pinhole shows of the picture that each lens alone would give, from 0 to 1.

    1 for the lenses that see least, which crop the pictures of all others, and for every lens if all are alike.
    """
    shared = focal_within(common_rectangle(lenses), width, height)
    return tuple((focal_within(common_rectangle([lens]), width, height) / shared) ** 2 for lens in lenses)


def cropping_lenses(lenses: Sequence[LensView], photos: Sequence[int], width: int, height: int) -> list[int]:
    """Numbers of the few lenses that crop the pictures of all others, such as lenses of rotated or zoomed photos.

    `photos` is the number of photos of each lens. Empty if the shared pinhole shows enough of most photos, or if more
    than a fraction `FEW` would have to go for that.
    """
    left, chosen, allowed = list(range(len(lenses))), list[int](), FEW * sum(photos)
    while left:
        shares = shares_shown([lenses[number] for number in left], width, height)
        every = sorted(np.repeat(shares, [photos[number] for number in left]))
        if every[(len(every) - 1) // 2] >= WIDE_ENOUGH:
            return sorted(chosen)
        narrowest = max(zip(shares, left, strict=True), key=lambda one: (one[0], -photos[one[1]]))[1]
        allowed -= photos[narrowest]
        if allowed < 0:
            return []
        left.remove(narrowest)
        chosen.append(narrowest)
    return []


def common_rectangle(lenses: Sequence[LensView]) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of what all lenses see, on the plane at depth 1; reversed or NaN if that is nothing."""
    rectangles = np.array([inner_rectangle(lens) for lens in lenses])
    left, top = rectangles[:, :2].max(axis=0).clip(-WIDEST_TANGENT)
    right, bottom = rectangles[:, 2:].min(axis=0).clip(max=WIDEST_TANGENT)
    return left, top, right, bottom


def focal_within(rectangle: tuple[float, float, float, float], width: int, height: int) -> float:
    """The shortest focal length, in pixels, at which a picture of this size fits into a rectangle at depth 1."""
    left, top, right, bottom = rectangle
    return max(width / (right - left), height / (bottom - top))


def inner_rectangle(lens: LensView) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of the largest upright rectangle inside a photo, on the plane at depth 1.

    A side is NaN if the lens model has no solution anywhere along it.
    """
    along = np.linspace(0, 1, BORDER_SAMPLES)
    zero, one = np.zeros_like(along), np.ones_like(along)
    sides = [(zero, along), (along, zero), (one, along), (along, one)]
    left, top, right, bottom = (lens.unproject(np.stack([x * lens.width, y * lens.height], axis=1)) for x, y in sides)
    return (
        float(np.fmax.reduce(left[:, 0])),
        float(np.fmax.reduce(top[:, 1])),
        float(np.fmin.reduce(right[:, 0])),
        float(np.fmin.reduce(bottom[:, 1])),
    )


def sees_whole_pinhole(lens: LensView, pinhole: Pinhole) -> bool:
    """Whether the pinhole's whole picture lies within the lens's photo, up to a thousandth of a pixel."""
    positions = corner_positions(lens, pinhole)
    inside = (positions >= -1e-3) & (positions <= np.array([lens.width, lens.height]) + 1e-3)
    return bool(inside.all())  # NaN is not inside


def corner_positions(lens: LensView, pinhole: Pinhole) -> Float32[np.ndarray, "rows columns 2"]:
    """Positions in the photo, in pixels, of the (height + 1) x (width + 1) corners of the pinhole's pixels."""
    y, x = np.mgrid[: pinhole.height + 1, : pinhole.width + 1].astype(np.float64)
    pixels = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    rays = pixels @ np.linalg.inv(pinhole.intrinsics).T
    return lens.project(rays).reshape(*x.shape, 2).astype(np.float32)


def undistort(
    photo: UInt8[np.ndarray, "h w 3"], corners: Float32[np.ndarray, "rows columns 2"]
) -> UInt8[np.ndarray, "height width 3"]:
    """The pinhole's picture, each pixel being the mean over its area in the photo.

    `corners` are the positions of its pixels' corners in this photo, from `corner_positions`. Samples are at most one
    photo pixel apart, to prevent aliasing; distortion is interpolated linearly within a training pixel.
    """
    steps = (np.abs(np.diff(corners, axis=0)).max(), np.abs(np.diff(corners, axis=1)).max())
    samples = max(1, int(np.ceil(max(steps) - 1e-3)))
    if samples > FINEST_SAMPLING:
        height, width = photo.shape[:2]
        smaller = tuple(max(1, round(side * FINEST_SAMPLING / samples)) for side in (width, height))
        photo = cv2.resize(photo, smaller, interpolation=cv2.INTER_AREA)
        corners = corners * np.array([smaller[0] / width, smaller[1] / height], np.float32)
        samples = FINEST_SAMPLING
    positions = refined(corners, samples) - np.float32(0.5)  # remap counts from the first pixel's centre
    sampled = cv2.remap(photo, positions, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    height, width = corners.shape[0] - 1, corners.shape[1] - 1
    means = sampled.reshape(height, samples, width, samples, 3).mean(axis=(1, 3), dtype=np.float32)
    return np.round(means).astype(np.uint8)


def refined(corners: Float32[np.ndarray, "rows columns 2"], samples: int) -> Float32[np.ndarray, "y x 2"]:
    """Positions of `samples` x `samples` points in every pixel, interpolated linearly between its corners."""
    for axis in (0, 1):
        count = corners.shape[axis] - 1
        place = (np.arange(count * samples) + 0.5) / samples
        before = place.astype(int)
        share = (place - before).astype(np.float32).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
        corners = corners.take(before, axis) * (1 - share) + corners.take(before + 1, axis) * share
    return corners
