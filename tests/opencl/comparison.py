"""Compares two rasterizers that round differently: tightly where pictures are smooth, for bounds and bias elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from opencl.contract import RasterOutput
from tests.opencl.discontinuities import Discontinuities, find_discontinuities
from tests.opencl.scenes import Scene

NAMES = ("means", "quats", "scales", "opacities", "features", "background")
_MOST_STANDARD_DEVIATIONS = 4.0
_SMALL_GRADIENT = 1e-3
"""If pixels have weights of about 1, a gradient smaller than this is nothing but rounding: a background's, behind
opaque layers."""


@dataclass(frozen=True)
class Tolerance:
    """How far two correct rasterizers may differ."""

    values: float
    """Difference in a smooth pixel, where 1 is the range of the features."""
    margin: float
    """Relative distance from a threshold within which rounding may decide."""
    depth_margin: float
    gradients: float
    """Relative error of each input's whole gradient, from smooth pixels."""
    gradients_at_thresholds: float
    """The same from all pixels."""


FLOAT32 = Tolerance(values=1e-5, margin=1e-3, depth_margin=1e-6, gradients=1e-4, gradients_at_thresholds=0.02)
FLOAT64 = Tolerance(values=1e-10, margin=1e-8, depth_margin=1e-14, gradients=1e-8, gradients_at_thresholds=1e-6)


def discontinuities_of(scene: Scene, tolerance: Tolerance, cut_sigmas: float | None = None) -> Discontinuities:
    """Discontinuities at the tolerance's margins. Fails if too little of the picture is smooth for a comparison."""
    found = find_discontinuities(scene, tolerance.margin, tolerance.depth_margin, cut_sigmas)
    smooth = found.smooth.double().mean().item()
    assert smooth > 0.3, f"only {smooth:.0%} of the picture is smooth: the comparison would be empty"
    return found


def compare_pictures(
    found: RasterOutput, expected: RasterOutput, scene: Scene, at: Discontinuities, tolerance: Tolerance
) -> None:
    """Compare features and alphas. Where `at.cut`, `expected` may lack what `found` draws, but not the reverse."""
    background = scene.background.double()
    colors = torch.cat([scene.features.double(), background[None]])
    spread = colors.amax(dim=0) - colors.amin(dim=0)
    differences = found.features.double() - expected.features.double()
    _check_bound("features", differences, spread * (at.influence[..., None] + tolerance.values))
    alpha_differences = found.alphas.double() - expected.alphas.double()
    _check_bound("alphas", alpha_differences, at.influence + tolerance.values)
    lacking = at.cut & (alpha_differences < -tolerance.values - _other_influence(at))
    assert not lacking.any(), f"{int(lacking.sum())} pixels beyond the cut lack what is drawn in the other picture"
    _check_bias(alpha_differences[~at.cut], tolerance)


def _other_influence(at: Discontinuities) -> Tensor:
    """The influence for which differences may have any sign: all of it where nothing is cut, a little elsewhere."""
    return torch.where(at.cut, 0.05 * at.influence, at.influence)


def _check_bound(what: str, differences: Tensor, allowed: Tensor) -> None:
    excess = differences.abs() - allowed
    if excess.max() > 0:
        place = tuple(int(index) for index in torch.unravel_index(excess.argmax(), excess.shape))
        raise AssertionError(
            f"{what} at {place} (row, column): differ by {differences[place].item():.3g}, "
            f"at most {allowed[place].item():.3g} is allowed; so do {int((excess > 0).sum())} of {excess.numel()}"
        )


def _check_bias(differences: Tensor, tolerance: Tolerance) -> None:
    """Rounding decides for either side equally often, so the sum of the differences is that of a random walk."""
    turned = differences[differences.abs() > tolerance.values]
    if len(turned) == 0:
        return
    deviations = (turned.sum() / turned.square().sum().sqrt()).abs().item()
    assert deviations < _MOST_STANDARD_DEVIATIONS, (
        f"biased at thresholds: {len(turned)} alphas differ, their sum lies {deviations:.1f} standard deviations from 0"
    )


def gradients_from(draw: Callable[..., RasterOutput], scene: Scene, pixels: Tensor, seed: int = 0) -> dict[str, Tensor]:
    """Gradients of a random linear function of features and alphas at `pixels` ([height, width], bool), by input."""
    leaves = {name: getattr(scene, name).clone().requires_grad_() for name in NAMES}
    changed = replace(scene, **leaves)
    output = draw(*changed.gaussians, *changed.camera, changed.background, changed.settings)
    random = torch.Generator().manual_seed(seed)
    loss = output.features.new_zeros(())
    for picture, chosen in ((output.features, pixels[..., None]), (output.alphas, pixels)):
        weights = torch.randn(picture.shape, generator=random, dtype=torch.float64).to(picture.dtype)
        loss = loss + (picture * weights * chosen).sum()
    return dict(zip(NAMES, torch.autograd.grad(loss, list(leaves.values())), strict=True))


def compare_gradients(found: dict[str, Tensor], expected: dict[str, Tensor], relative: float) -> None:
    """Compare each input's gradient as a whole; if none is expected, none may be found."""
    for name, wanted in expected.items():
        error = (found[name].double() - wanted.double()).norm().item()
        allowed = relative * (wanted.double().norm().item() + _SMALL_GRADIENT)
        assert error < allowed, f"gradient of {name}: differs by {error:.3g}, at most {allowed:.3g} is allowed"
