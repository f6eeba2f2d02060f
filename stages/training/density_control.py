"""Adaptive density control (3DGS, section 5.2): clone and split where gradients are large, prune what is not seen."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stages.hiding.rendering import Rendering
from stages.scene.gaussians import Gaussians, rotation_matrices
from stages.training.optimizer import GaussianOptimizer

CHILDREN = 2
CHILD_SHRINKAGE = 0.8 * CHILDREN
"""The children of a split Gaussian are 1.6 times smaller."""

RESET_OPACITY = 0.01


@dataclass(frozen=True)
class DensitySettings:
    """3DGS's thresholds, as its code applies them.

    `gradient_threshold`: mean screen-space gradient, in normalised device coordinates, above which a Gaussian is
    refined; `dense_fraction` of the rig's extent: scale up to which it is cloned, and above which it is split;
    `smallest_opacity`: below it, Gaussians are pruned; `largest_fraction` of the extent: scale above which they are
    pruned after the first opacity reset; `maximum_gaussians`: a bound on their number, which 3DGS does not have. Those
    with the largest gradients are refined first.

    3DGS's code also compares radii on the screen with 20 pixels, but sets them to zero just before. So this never
    pruned anything, in its paper neither, as its authors say (issues 123 and 643 of their repository). Pruning by that
    radius would cost a scene most of its Gaussians.
    """

    gradient_threshold: float = 2e-4
    dense_fraction: float = 0.01
    smallest_opacity: float = 0.005
    largest_fraction: float = 0.1
    maximum_gaussians: int = 1_000_000


class DensityControl:
    """Accumulates the rasterizer's statistics between two refinements, then refines.

    `limited`: whether the bound on Gaussians has prevented any refinement so far.
    """

    def __init__(self, settings: DensitySettings, extent: float, count: int, device: torch.device | str = "cpu"):
        """Start without statistics for `count` Gaussians on `device`, where statistics are kept."""
        self.settings = settings
        self.extent = extent
        self.device = device
        self.limited = False
        self._forget(count)

    def _forget(self, count: int) -> None:
        self.gradient_sums = torch.zeros(count, device=self.device)
        self.views_seen = torch.zeros(count, device=self.device)

    def observe(self, rendering: Rendering, width: int, height: int) -> None:
        """Add one view's screen-space gradients, after backward, in normalised device coordinates as in 3DGS.

        A Gaussian counts as seen if it reaches a pixel. In 3DGS, its rectangle only has to overlap a tile of the
        picture. So fewer views count for Gaussians at the edges, and dilute the mean gradient less.
        """
        gradient = rendering.means2d.grad
        if gradient is None:
            return
        visible = rendering.radii > 0
        norms = torch.hypot(gradient[:, 0] * (width / 2), gradient[:, 1] * (height / 2))
        self.gradient_sums += torch.where(visible, norms, 0)
        self.views_seen += visible

    def refine(self, optimizer: GaussianOptimizer, prune_large: bool, generator: torch.Generator) -> None:
        """Clone small and split large Gaussians with large gradients, and prune transparent and overgrown ones.

        `generator` is on the CPU, whatever the device, so that a seed gives the same numbers on all devices.

        (3DGS prunes after cloning and splitting, including copies and children of a transparent Gaussian, and children
        that are still overgrown. Here, these remain until the next refinement, and after the last one for good: for the
        fox, that was 4 of 60,000 Gaussians in 1,000 iterations.)
        """
        gaussians = optimizer.gaussians
        with torch.no_grad():
            strength = self.gradient_sums / self.views_seen.clamp_min(1)
            chosen = self._strongest(strength, len(gaussians))
            large = gaussians.scales.max(dim=1).values > self.settings.dense_fraction * self.extent
            cloned = (chosen & ~large).nonzero().squeeze(1)
            split = (chosen & large).nonzero().squeeze(1)
            doomed = self._doomed(gaussians, prune_large)
            doomed[split] = True
            children = _children(gaussians, split, generator)
            added = {
                name: torch.cat([tensor.detach()[cloned], children[name]])
                for name, tensor in gaussians.parameters.items()
            }
            optimizer.rearrange((~doomed).nonzero().squeeze(1), added)
        self._forget(len(gaussians))

    def reset_opacity(self, optimizer: GaussianOptimizer) -> None:
        """Lower every opacity to at most 0.01: Gaussians that are needed recover, the others can be pruned."""
        logits = optimizer.gaussians["logit_opacities"].detach()
        ceiling = torch.logit(logits.new_tensor(RESET_OPACITY))
        optimizer.overwrite("logit_opacities", logits.clamp_max(ceiling))

    def _strongest(self, strength: Float[Tensor, " N"], count: int) -> Bool[Tensor, " N"]:
        chosen = strength >= self.settings.gradient_threshold
        room = max(0, self.settings.maximum_gaussians - count)
        if int(chosen.sum()) > room:
            self.limited = True
            order = torch.argsort(strength, descending=True, stable=True)[:room]
            limited = torch.zeros_like(chosen)
            limited[order] = True
            chosen &= limited
        return chosen

    def _doomed(self, gaussians: Gaussians, prune_large: bool) -> Bool[Tensor, " N"]:
        doomed = gaussians.opacities < self.settings.smallest_opacity
        if prune_large:
            doomed |= gaussians.scales.max(dim=1).values > self.settings.largest_fraction * self.extent
        return doomed


def _children(gaussians: Gaussians, parents: Int[Tensor, " P"], generator: torch.Generator) -> dict[str, Tensor]:
    """Two Gaussians sampled from each parent's density, 1.6 times smaller, with the parent's other attributes."""
    rows = parents.repeat(CHILDREN)
    children = {name: tensor.detach()[rows] for name, tensor in gaussians.parameters.items()}
    drawn = torch.randn(len(rows), 3, generator=generator).to(gaussians.device)
    offsets = drawn * children["log_scales"].exp()
    rotations = rotation_matrices(children["quats"])
    children["means"] = children["means"] + torch.einsum("nij,nj->ni", rotations, offsets)
    children["log_scales"] = children["log_scales"] - torch.log(torch.tensor(CHILD_SHRINKAGE))
    return children
