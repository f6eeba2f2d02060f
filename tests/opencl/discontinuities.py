"""Where a rasterizer is discontinuous: pixels at which rounding decides what is drawn, and how much depends on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from opencl.reference import ProjectedGaussians, project_reference

if TYPE_CHECKING:
    from tests.opencl.scenes import Scene


_NEGLIGIBLE = 1e-13
"""A share of a pixel so small that no decision about it matters: it lies behind opaque layers."""


@dataclass(frozen=True)
class Discontinuities:
    """The discontinuities of a picture. All tensors are [height, width]."""

    influence: Tensor
    """The share of the pixel that depends on decisions that rounding may reverse; 0 if there are none."""
    kinks: Tensor
    """Where alpha is close to its clamp: the picture is continuous there, but its gradient is not."""
    cut: Tensor
    """Where a Gaussian is drawn beyond the radius at which another rasterizer may cut it off."""

    @property
    def smooth(self) -> Tensor:
        """Where pictures and gradients must agree up to rounding."""
        return (self.influence == 0) & ~self.kinks


def find_discontinuities(
    scene: Scene, margin: float, depth_margin: float = -1.0, cut_sigmas: float | None = None
) -> Discontinuities:
    """Walk all Gaussians front to back in float64.

    Args:
        margin: relative distance from a threshold within which alpha and transmittance are undecided.
        depth_margin: relative distance of two depths within which their order is undecided; negative: never.
        cut_sigmas: the other rasterizer may omit pixels that are farther from the centre, horizontally or vertically,
            than so many standard deviations of the longest axis.
    """
    scene = scene.to(torch.float64)
    projected = project_reference(*scene.gaussians, *scene.camera, scene.settings)
    order = projected.visible.nonzero().squeeze(-1)
    order = order[torch.sort(projected.depths[order], stable=True).indices]
    walk = _Walk(scene, projected, margin, depth_margin)
    for index in order.tolist():
        walk.step(index, cut_sigmas)
    return Discontinuities(walk.influence, walk.kinks, walk.cut)


class _Walk:
    """The state of all pixels while walking from front to back."""

    def __init__(self, scene: Scene, projected: ProjectedGaussians, margin: float, depth_margin: float) -> None:
        self._scene, self._projected = scene, projected
        self._margin, self._depth_margin = margin, depth_margin
        rows, columns = torch.meshgrid(
            *(torch.arange(side, dtype=torch.float64) + 0.5 for side in (scene.height, scene.width)), indexing="ij"
        )
        self._pixels = torch.stack([columns, rows], dim=-1)
        self._transmittance = torch.ones_like(rows)
        self._doubt = torch.zeros_like(rows)  # relative, of the transmittance
        self._last_depth, self._tied_alpha = -torch.inf, torch.zeros_like(rows)
        self.influence = torch.zeros_like(rows)
        self.kinks, self.cut = torch.zeros_like(rows, dtype=torch.bool), torch.zeros_like(rows, dtype=torch.bool)

    def step(self, index: int, cut_sigmas: float | None) -> None:
        """Process the next Gaussian."""
        settings = self._scene.settings
        offset = self._pixels - self._projected.means[index]
        covariance = self._projected.covariances[index]
        power = -0.5 * torch.einsum("hwi,ij,hwj->hw", offset, torch.linalg.inv(covariance), offset)
        exact = self._scene.opacities[index] * power.exp()
        alpha = exact.clamp_max(settings.alpha_maximum)
        after = self._transmittance * (1 - alpha)
        reached = alpha >= settings.alpha_minimum

        share = alpha * self._transmittance
        seen = share > _NEGLIGIBLE
        undecided = seen & self._near(alpha, settings.alpha_minimum, self._margin)
        ends = seen & (reached | undecided)
        ends &= self._near(after, settings.transmittance_minimum, self._margin + self._doubt)
        if cut_sigmas is not None:
            radius = cut_sigmas * torch.linalg.eigvalsh(covariance)[-1].sqrt()
            beyond = seen & (reached | undecided) & (offset.abs().amax(dim=-1) > radius * (1 - self._margin))
            self.cut |= beyond
            undecided = undecided | beyond
        self.influence += torch.where(undecided | ends, share, 0.0) + torch.where(ends, after, 0.0)
        self.kinks |= seen & self._near(exact, settings.alpha_maximum, self._margin)
        self._doubt += torch.where(undecided, alpha, 0.0)
        self._tie(index, torch.where(reached, alpha, 0.0), share)

        drawn = reached & (after >= settings.transmittance_minimum)
        finished = reached & ~drawn
        self._transmittance = torch.where(drawn, after, torch.where(finished & ~ends, 0.0, self._transmittance))

    def _tie(self, index: int, alpha: Tensor, share: Tensor) -> None:
        """Add the influence of an undecided order of Gaussians: what one takes from the other's light."""
        depth = float(self._projected.depths[index])
        if depth - self._last_depth > self._depth_margin * depth:
            self._tied_alpha = torch.zeros_like(alpha)
        self.influence += torch.where((alpha > 0) & (share > _NEGLIGIBLE), share * self._tied_alpha, 0.0)
        self._tied_alpha, self._last_depth = self._tied_alpha + alpha, depth

    @staticmethod
    def _near(value: Tensor, threshold: float, margin: float | Tensor) -> Tensor:
        if threshold == 0:
            return torch.zeros_like(value, dtype=torch.bool)
        return (value / threshold - 1).abs() < margin
