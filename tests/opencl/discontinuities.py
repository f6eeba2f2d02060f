"""Where a rasterizer is discontinuous: pixels at which rounding decides what is drawn, and how much hangs on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from opencl.reference import ProjectedGaussians, project_reference

if TYPE_CHECKING:
    from tests.opencl.scenes import Scene


_NEGLIGIBLE = 1e-13
"""Share of a pixel on which nothing depends, whatever is decided there: it lies behind opaque layers."""


@dataclass(frozen=True)
class Discontinuities:
    """All [height, width]."""

    influence: Tensor
    """The share of the pixel that depends on decisions which rounding may turn: 0 where there is none."""
    kinks: Tensor
    """Where alpha is next to its clamp: the picture is continuous there, its gradient is not."""
    cut: Tensor
    """Where a Gaussian is drawn beyond the radius at which another rasterizer may cut it off."""

    @property
    def smooth(self) -> Tensor:
        """Where pictures and gradients are to agree but for rounding."""
        return (self.influence == 0) & ~self.kinks


def find_discontinuities(
    scene: Scene, margin: float, depth_margin: float = -1.0, cut_sigmas: float | None = None
) -> Discontinuities:
    """Walk all Gaussians front to back in float64.

    Args:
        margin: how near alpha and transmittance must come to a threshold, relatively.
        depth_margin: how near two depths must be, relatively, for their order to be undecided; negative: never.
        cut_sigmas: the other rasterizer may leave out pixels farther than so many standard deviations of the longest
            axis, across or down.
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
    """The state of all pixels on the way from front to back."""

    def __init__(self, scene: Scene, projected: ProjectedGaussians, margin: float, depth_margin: float) -> None:
        self._scene, self._projected = scene, projected
        self._margin, self._depth_margin = margin, depth_margin
        rows, columns = torch.meshgrid(
            *(torch.arange(side, dtype=torch.float64) + 0.5 for side in (scene.height, scene.width)), indexing="ij"
        )
        self._pixels = torch.stack([columns, rows], dim=-1)
        self._transmittance = torch.ones_like(rows)
        self._doubt = torch.zeros_like(rows)  # of the transmittance, relatively
        self._last_depth, self._tied_alpha = -torch.inf, torch.zeros_like(rows)
        self.influence = torch.zeros_like(rows)
        self.kinks, self.cut = torch.zeros_like(rows, dtype=torch.bool), torch.zeros_like(rows, dtype=torch.bool)

    def step(self, index: int, cut_sigmas: float | None) -> None:
        """The next Gaussian."""
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
        """Two Gaussians whose order is undecided: what one takes from the other's light."""
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
