"""The settings and the result of the rasterizer."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Literal, SupportsFloat

from jaxtyping import Float, Int
from torch import Tensor

SMALLEST_LOW_PASS = 1e-6
"""Smallest `low_pass`, in square pixels. Its square is far above the smallest positive float32."""
SMALLEST, LARGEST = 1e-30, 1e30
"""Bounds of the settings that must be positive: in float32, such values are neither 0 nor infinite."""
CLEAREST = 1e-6
"""Minimum of 1 - `alpha_maximum`, the light that every Gaussian transmits. float32 can tell 1 - 1e-6 from 1."""


@dataclass(frozen=True)
class RasterSettings:
    """All constants of the rasterizer. The defaults are those of 3D Gaussian Splatting (3DGS, Kerbl et al. 2023).

    The rasterizer differs from the code of 3DGS in four ways:

    - A Gaussian is drawn wherever its alpha reaches `alpha_minimum`; 3DGS skips tiles beyond 3 standard deviations.
    - `radii` are 0 if the box around the drawn area contains no pixel centre; those of 3DGS if it touches no tile.
    - Alphas clamped to `alpha_maximum` pass no gradient; those of 3DGS do.
    - The gradient of the depth is exact where the field of view is clamped; 3DGS counts one of its terms twice.

    For gsplat, use `RasterSettings(near=0.01, alpha_maximum=0.999, radius_sigmas=3.33, clamp_about="principal_point")`.
    """

    near: float = 0.2
    """Near plane: Gaussians up to this depth, in world units, are not drawn."""
    low_pass: float = 0.3
    """Added to both screen-space variances, in square pixels, so that no Gaussian falls between pixel centres. As it
    gets smaller, gradients of needle-shaped Gaussians lose precision: in float32 on CPUs, their relative error is 3e-6
    at 0.3, 1e-3 at 0.01 and 0.03 at 1e-4."""
    field_of_view_margin: float = 1.3
    """The projection is linearised at most this many half fields of view, measured as tangents, from the middle."""
    clamp_about: Literal["optical_axis", "principal_point"] = "optical_axis"
    """Reference of that clamp: the optical axis, as in 3DGS, or the true borders of the picture, as in gsplat."""
    alpha_maximum: float = 0.99
    """Upper bound to which the alpha of a Gaussian at a pixel is clamped."""
    alpha_minimum: float = 1 / 255
    """A Gaussian is skipped at exactly those pixels where its alpha is below this."""
    transmittance_minimum: float = 1e-4
    """A pixel is finished before the Gaussian that would reduce its transmittance below this."""
    radius_sigmas: float = 3.0
    """`radii` are this many standard deviations along the longer screen axis, rounded up."""
    antialiased: bool = False
    """Whether opacities are reduced to compensate for the area that `low_pass` adds to an ellipse, so that small
    Gaussians do not get brighter from afar (Mip-Splatting, Yu et al. 2024; gsplat's "antialiased")."""

    def __post_init__(self) -> None:
        for field in fields(self):
            if isinstance(field.default, float):
                object.__setattr__(self, field.name, _finite(field.name, getattr(self, field.name)))
        if not isinstance(self.antialiased, bool):
            raise ValueError(f"RasterSettings.antialiased: found {self.antialiased!r}, expected True or False")
        if self.clamp_about not in ("optical_axis", "principal_point"):
            raise ValueError(
                f"RasterSettings.clamp_about: found {self.clamp_about!r}, expected 'optical_axis' or 'principal_point'"
            )
        for name in ("near", "low_pass", "alpha_minimum", "radius_sigmas", "field_of_view_margin"):
            if not SMALLEST <= getattr(self, name) <= LARGEST:
                raise ValueError(
                    f"RasterSettings.{name}: found {getattr(self, name)}, expected more than 0, "
                    f"from {SMALLEST:g} to {LARGEST:g}"
                )
        if self.low_pass < SMALLEST_LOW_PASS:
            raise ValueError(
                f"RasterSettings.low_pass: found {self.low_pass}, expected {SMALLEST_LOW_PASS} at least, under which "
                "variances in float32 have no inverse"
            )
        if not self.alpha_minimum <= self.alpha_maximum <= 1 - CLEAREST:
            raise ValueError(
                f"RasterSettings.alpha_maximum: found {self.alpha_maximum}, "
                f"expected at least alpha_minimum ({self.alpha_minimum}) and less than 1 by {CLEAREST:g}"
            )
        let_through = (1 - self.alpha_maximum) * (1 + CLEAREST)
        if not 0 <= self.transmittance_minimum <= let_through:
            raise ValueError(
                f"RasterSettings.transmittance_minimum: found {self.transmittance_minimum}, expected 0 or more, and no "
                f"more than alpha_maximum lets through ({1 - self.alpha_maximum:.3g}): the first opaque Gaussian would "
                "end its pixel before it is drawn"
            )

    def for_fewer_pixels(self, factor: float) -> RasterSettings:
        """Settings for a picture `factor` times as wide (0 < factor <= 1) that samples pixels of the whole picture.

        `low_pass` is scaled by factor², down to `SMALLEST_LOW_PASS`, so that the filter keeps its width in the scene.
        With the same width in the larger pixels, it would make Gaussians swell.
        """
        return replace(self, low_pass=max(self.low_pass * factor**2, SMALLEST_LOW_PASS))


def _finite(name: str, value: object) -> float:
    """Convert a number, NumPy's and torch's included, to a Python float. Raises ValueError if it is not finite."""
    number = math.nan
    if isinstance(value, SupportsFloat) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"RasterSettings.{name}: found {value!r:.80}, expected a finite number")
    return number


@dataclass(frozen=True)
class RasterOutput:
    """A rendered picture, or a batch of pictures, with the statistics of Gaussians that density control needs."""

    features: Float[Tensor, "*cameras height width M"]
    """Features blended over the background. Contiguous: permuted to [1, M, H, W], they are channels-last."""
    alphas: Float[Tensor, "*cameras height width"]
    """Coverage of each pixel by Gaussians: 1 - the remaining transmittance."""
    radii: Int[Tensor, "*cameras N"]
    """`ceil(radius_sigmas · sigma)` along the longer axis, in pixels (int32). 0 if the box around the drawn area
    contains no pixel centre. No gradient."""
    means2d: Float[Tensor, "*cameras N 2"]
    """Centres (x, y) in pixels, with pixel centres at +0.5; zero if not visible. `.grad` is set by backward."""
    depths: Float[Tensor, "*cameras height width"] | None = None
    """If requested: blended depths of the centres, in world units. Divide by `alphas` for the expected depths."""
    absolute_gradients: Float[Tensor, "*cameras N 2"] | None = None
    """If requested: zeros whose `.grad` after backward is the sum, over pixels, of the absolute values of the gradient
    of `means2d`."""
    pixel_counts: Int[Tensor, "*cameras N"] | None = None
    """If requested: the number of pixels in which each Gaussian is drawn (int32). No gradient."""


def half_fields_of_view(
    intrinsics: Float[Tensor, "3 3"], width: int, height: int, settings: RasterSettings
) -> tuple[float, float, float, float]:
    """Clamp of x/z and y/z for the linearised projection: (left, right, top, bottom), left < right, top < bottom."""
    (fx, _, cx), (_, fy, cy), _ = intrinsics.tolist()
    tan_x, tan_y = 0.5 * width / fx, 0.5 * height / fy
    margin = settings.field_of_view_margin
    if settings.clamp_about == "optical_axis":
        return -margin * tan_x, margin * tan_x, -margin * tan_y, margin * tan_y
    beyond_x, beyond_y = (margin - 1) * tan_x, (margin - 1) * tan_y
    return -cx / fx - beyond_x, (width - cx) / fx + beyond_x, -cy / fy - beyond_y, (height - cy) / fy + beyond_y
