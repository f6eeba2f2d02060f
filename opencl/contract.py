"""What goes into the rasterizer and what comes out: settings and result."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Literal, SupportsFloat

from jaxtyping import Float, Int
from torch import Tensor

SMALLEST_LOW_PASS = 1e-6
"""Square pixels: the square of this is far from the smallest number that float32 can tell from 0."""
SMALLEST, LARGEST = 1e-30, 1e30
"""Of every constant: in float32 these are neither 0 nor infinite."""
CLEAREST = 1e-6
"""What a Gaussian lets through at least; float32 can tell 1 less this from 1."""


@dataclass(frozen=True)
class RasterSettings:
    """Every constant of the rasterizer; the defaults are those of 3D Gaussian Splatting (Kerbl et al. 2023).

    What differs from its code: a Gaussian is drawn wherever it is more opaque than `alpha_minimum`, where that draws
    only tiles within 3 standard deviations; `radii` are 0 where the box around what is reached holds no pixel, where
    its are where no tile is touched; opacities that were clamped to `alpha_maximum` pass no gradient, where it lets
    them; and where the field of view is clamped the gradient of the depth is exact, of which it takes one term twice.

    gsplat's are `RasterSettings(near=0.01, alpha_maximum=0.999, radius_sigmas=3.33, clamp_about="principal_point")`.
    """

    near: float = 0.2
    """Depth, in world units, up to which a Gaussian is not drawn."""
    low_pass: float = 0.3
    """Added to both variances on the screen, in square pixels, so that no Gaussian falls between the pixels. In float32
    on CPUs gradients of needles lose digits as it falls: 1e-3 of them at 0.01, 0.03 at 1e-4 (at 0.3 3e-6)."""
    field_of_view_margin: float = 1.3
    """Where the projection is linearised: at most this many half fields of view (as tangents) off the middle."""
    clamp_about: Literal["optical_axis", "principal_point"] = "optical_axis"
    """The middle of that clamp: the optical axis as 3DGS has it, or the picture's true borders as gsplat has it."""
    alpha_maximum: float = 0.99
    """Opacity of one Gaussian at one pixel is clamped to this."""
    alpha_minimum: float = 1 / 255
    """A Gaussian is skipped at pixels where its opacity is below this, and reaches all others."""
    transmittance_minimum: float = 1e-4
    """A pixel is finished before its transmittance would fall under this."""
    radius_sigmas: float = 3.0
    """`radii` are this many standard deviations of the longest axis, rounded up."""
    antialiased: bool = False
    """Whether opacities fall by what `low_pass` adds to an ellipse's area, so that small Gaussians do not grow brighter
    when seen from afar (Mip-Splatting, Yu et al. 2024; gsplat's "antialiased")."""

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
        """For pictures `factor` times as wide (0 < factor <= 1) that show what some pixels of the whole picture do.

        The low-pass stays as wide as it is there; in as many of the larger pixels it would make Gaussians swell.
        """
        return replace(self, low_pass=max(self.low_pass * factor**2, SMALLEST_LOW_PASS))


def _finite(name: str, value: object) -> float:
    """A setting as Python's float: NumPy's and torch's numbers are none of its types."""
    number = math.nan
    if isinstance(value, SupportsFloat) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"RasterSettings.{name}: found {value!r:.80}, expected a finite number")
    return number


@dataclass(frozen=True)
class RasterOutput:
    """A rendered picture, or a batch of them, and what density control needs to know of its Gaussians."""

    features: Float[Tensor, "*cameras height width M"]
    """Blended features over the background, contiguous; permuted to [1, M, H, W] it is channels-last."""
    alphas: Float[Tensor, "*cameras height width"]
    """How much of each pixel the Gaussians cover: one less the transmittance that is left."""
    radii: Int[Tensor, "*cameras N"]
    """Pixels, `ceil(radius_sigmas · sigma)` of the longest axis (int32); 0 where the box around what is reached holds
    no pixel. No gradient."""
    means2d: Float[Tensor, "*cameras N 2"]
    """Centres in pixels, x then y, pixel centres at +0.5, zero where not visible; `.grad` is there after backward."""
    depths: Float[Tensor, "*cameras height width"] | None = None
    """Where asked for, the centres' depths in world units, blended; divided by `alphas`, the expected depths."""
    absolute_gradients: Float[Tensor, "*cameras N 2"] | None = None
    """Where asked for, zeros whose `.grad` is, after backward, the sum over the pixels of the absolute values of the
    gradient of `means2d`."""
    pixel_counts: Int[Tensor, "*cameras N"] | None = None
    """Where asked for, in how many pixels each Gaussian is drawn (int32). No gradient."""


def half_fields_of_view(
    intrinsics: Float[Tensor, "3 3"], width: int, height: int, settings: RasterSettings
) -> tuple[float, float, float, float]:
    """The clamp of x/z and y/z where the projection is linearised: (left, right, top, bottom), lower ends negative."""
    (fx, _, cx), (_, fy, cy), _ = intrinsics.tolist()
    tan_x, tan_y = 0.5 * width / fx, 0.5 * height / fy
    margin = settings.field_of_view_margin
    if settings.clamp_about == "optical_axis":
        return -margin * tan_x, margin * tan_x, -margin * tan_y, margin * tan_y
    beyond_x, beyond_y = (margin - 1) * tan_x, (margin - 1) * tan_y
    return -cx / fx - beyond_x, (width - cx) / fx + beyond_x, -cy / fy - beyond_y, (height - cy) / fy + beyond_y
