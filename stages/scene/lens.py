"""Lenses by the names of COLMAP's models: focal length, principal point and distortion as plain numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

MODELS = {
    "SIMPLE_PINHOLE": (1, 0),
    "PINHOLE": (2, 0),
    "SIMPLE_RADIAL": (1, 1),
    "RADIAL": (1, 2),
    "OPENCV": (2, 4),
    "OPENCV_FISHEYE": (2, 4),
    "FULL_OPENCV": (2, 8),
    "FOV": (2, 1),
    "SIMPLE_RADIAL_FISHEYE": (1, 1),
    "RADIAL_FISHEYE": (1, 2),
    "THIN_PRISM_FISHEYE": (2, 8),
    "RAD_TAN_THIN_PRISM_FISHEYE": (2, 12),
    "SIMPLE_DIVISION": (1, 1),
    "DIVISION": (2, 1),
    "SIMPLE_FISHEYE": (1, 0),
    "FISHEYE": (2, 0),
    "EUCM": (2, 2),
}
"""Models in the order of COLMAP's model ids, with their numbers of focal lengths and of distortion parameters.

The parameters are the focal lengths, the principal point (two), then the distortion."""


TWO_FOCAL_LENGTHS = {
    "SIMPLE_PINHOLE": "PINHOLE",
    "SIMPLE_RADIAL": "OPENCV",
    "RADIAL": "OPENCV",
    "SIMPLE_RADIAL_FISHEYE": "OPENCV_FISHEYE",
    "RADIAL_FISHEYE": "OPENCV_FISHEYE",
    "SIMPLE_DIVISION": "DIVISION",
    "SIMPLE_FISHEYE": "FISHEYE",
}
"""The equivalent with two focal lengths of each model with one; further distortion parameters are zero."""

LARGEST_SIDE = 1_000_000
"""Pixels of a picture's side: no file holds more, and integers in a COLMAP model may be too large for a float."""

LONGEST, SHORTEST = 1e5, 1e-3
"""Limits of focal lengths, in longer sides of the picture; the first also limits the principal point. No lens is beyond
them, and float32 would lose the pixel."""

STRONGEST = 1e6
"""Largest magnitude of a distortion parameter."""


@dataclass(frozen=True)
class Lens:
    """A COLMAP camera model, its parameters in COLMAP's order, and the picture's size in pixels.

    Pixel centres are at +0.5. Raises `ValueError` for an unknown model, a wrong number of parameters, values that are
    not finite, focal lengths or sizes that are not positive, and what no lens has (`LARGEST_SIDE`, `LONGEST`,
    `SHORTEST`, `STRONGEST`).
    """

    model: str
    parameters: tuple[float, ...]
    width: int
    height: int

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ValueError(f"camera model {self.model} is not known; known are {', '.join(MODELS)}")
        expected = sum(MODELS[self.model]) + 2
        if len(self.parameters) != expected:
            raise ValueError(f"a {self.model} camera has {len(self.parameters)} parameters; expected {expected}")
        if not all(math.isfinite(value) for value in self.parameters):
            raise ValueError(f"a {self.model} camera's parameters are not finite: {self.parameters}")
        if min(self.parameters[: MODELS[self.model][0]]) <= 0 or min(self.width, self.height) < 1:
            raise ValueError(f"a camera has a focal length or a size that is not positive: {self}")
        if max(self.width, self.height) > LARGEST_SIDE:
            raise ValueError(f"a camera has a side of more than {LARGEST_SIDE:,} pixels")
        self._refuse_what_no_lens_has()

    def _refuse_what_no_lens_has(self) -> None:
        side, count = max(self.width, self.height), MODELS[self.model][0]
        focal, centre = self.parameters[:count], self.parameters[count : count + 2]
        distortion = self.parameters[count + 2 :]
        if not SHORTEST * side <= min(focal) <= max(focal) <= LONGEST * side:
            found, expected = f"focal lengths of {focal}", f"{SHORTEST:g} to {LONGEST:g} times its longer side"
        elif max(map(abs, centre)) > LONGEST * side:
            found, expected = f"a principal point at {centre}", f"at most {LONGEST:g} times its longer side off"
        elif max(map(abs, distortion), default=0.0) > STRONGEST:
            found, expected = f"distortion by {distortion}", f"at most {STRONGEST:g}"
        else:
            return
        raise ValueError(f"a {self.model} camera of {self.width} x {self.height} has {found}; expected {expected}")

    @staticmethod
    def pinhole(matrix: Float64[np.ndarray, "3 3"], width: int, height: int) -> Lens:
        """A lens without distortion, from an intrinsic matrix."""
        return Lens("PINHOLE", tuple(float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))), width, height)

    def matrix(self) -> Float64[np.ndarray, "3 3"]:
        """The intrinsic matrix, in pixels."""
        count = MODELS[self.model][0]
        x, y = self.parameters[count : count + 2]
        return np.array([[self.parameters[0], 0, x], [0, self.parameters[count - 1], y], [0, 0, 1.0]])

    def resized(self, width: int, height: int) -> Lens:
        """The same lens for a resized picture; distortion is relative to the focal length and stays.

        It has two focal lengths if the sides, which are whole numbers of pixels, scale by different factors.
        """
        across, down = width / self.width, height / self.height
        lens = self if across == down else self.with_two_focal_lengths()
        focal_lengths, distortions = MODELS[lens.model]
        factors = [across, down][:focal_lengths] + [across, down] + [1.0] * distortions
        scaled = tuple(value * factor for value, factor in zip(lens.parameters, factors, strict=True))
        return replace(lens, parameters=scaled, width=width, height=height)

    def with_two_focal_lengths(self) -> Lens:
        """The equivalent lens of a model with separate focal lengths for x and y."""
        if self.model not in TWO_FOCAL_LENGTHS:
            return self
        model, (focal, *others) = TWO_FOCAL_LENGTHS[self.model], self.parameters
        zeros = [0.0] * (sum(MODELS[model]) - sum(MODELS[self.model]) - 1)
        return replace(self, model=model, parameters=(focal, focal, *others, *zeros))
