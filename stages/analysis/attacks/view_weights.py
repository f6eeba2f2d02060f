"""Pruning of Gaussians that weigh much in what is blended and little in what the cover shows.

GSPure (AAAI 2026) clusters Gaussians by their weights in views and prunes what serves the message. Only that idea is
known here, not its code: weights, clusters and their order are as written below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.cluster.vq import kmeans2
from torch import Tensor

from stages.analysis.attacks.target import Attacker, Knowledge, Target
from stages.hiding.rendering import COVER, splat
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians

CLUSTERS = 32
MOST_VIEWS = 64
"""Of the training views, evenly spread, that weights and influences are summed over."""

SMALLEST = 1e-6
"""Of a pixel: weights and influences under it are all alike."""


@dataclass(frozen=True)
class Weights:
    """Of each Gaussian, over views: `weight` is what it has in the blended pictures, Σ T α over all pixels; `influence`
    how much the decoded cover would change without it, to first order: the root of the sum of squares over all pixels.
    """

    weight: Float[Tensor, " N"]
    influence: Float[Tensor, " N"]


def view_weight_pruning(target: Target, seed: int, knowledge: Knowledge) -> Attacker:
    """Prune the share of the Gaussians whose clusters have the least influence on the cover for their weight.

    The attacker knows the container, its scene decoder included, and where the training cameras stood. Gaussians are
    clustered by k-means on the logarithms of weight and influence; clusters go in ascending order of their mean
    influence over their mean weight, and the Gaussians of the last one that goes in ascending order of influence.
    Those that no view shows go first: neither picture needs them.
    """
    order = pruning_order(view_weights(target, seed, knowledge), seed)
    return lambda share: target.keeping(order[round(share * len(order)) :].sort().values)


def view_weights(target: Target, seed: int, knowledge: Knowledge) -> Weights:
    """By two backward passes a view.

    The weights are the gradient of the sum of a blended constant. The influence of opacity α_i is estimated as by
    Hutchinson: with a random sign z for each colour of each pixel, the square of α_i ∂(z · cover)/∂α_i is on average
    the sum of squares over pixels.
    """
    generator = torch.Generator().manual_seed(seed)
    cameras = knowledge.views.cameras
    chosen = torch.linspace(0, len(cameras) - 1, min(MOST_VIEWS, len(cameras))).round().int().tolist()
    weight, squares = torch.zeros(len(target.gaussians)), torch.zeros(len(target.gaussians))
    for view in chosen:
        weight += _blending_weights(target.gaussians, cameras[view])
        squares += _squared_influence(target, cameras[view], generator)
        knowledge.after_each()
    return Weights(weight, squares.sqrt())


def pruning_order(weights: Weights, seed: int) -> Int[Tensor, " N"]:
    """The rows of all Gaussians in the order in which they are pruned."""
    seen = weights.weight > SMALLEST
    rows = seen.nonzero().squeeze(1)
    if len(rows) < CLUSTERS:
        ratio = weights.influence / weights.weight.clamp_min(SMALLEST)
        return torch.cat([(~seen).nonzero().squeeze(1), rows[ratio[rows].argsort(stable=True)]])
    weight, influence = weights.weight[rows], weights.influence[rows].clamp_min(SMALLEST)
    labels = _clusters(torch.stack([weight.log(), influence.log()], dim=1), seed)
    totals = torch.zeros(2, CLUSTERS).index_add(1, labels, torch.stack([influence, weight]))
    ratio = totals[0] / totals[1].clamp_min(SMALLEST)
    order = np.lexsort([influence.numpy(), labels.numpy(), ratio[labels].numpy()])
    return torch.cat([(~seen).nonzero().squeeze(1), rows[torch.from_numpy(order)]])


def _clusters(values: Float[Tensor, "N D"], seed: int) -> Int[Tensor, " N"]:
    standardised = ((values - values.mean(dim=0)) / values.std(dim=0).clamp_min(SMALLEST)).double().numpy()
    _, labels = kmeans2(standardised, CLUSTERS, minit="++", seed=np.random.default_rng(seed), missing="warn")
    return torch.from_numpy(labels).long()


def _blending_weights(gaussians: Gaussians, camera: Camera) -> Float[Tensor, " N"]:
    constant = torch.ones(len(gaussians), 1, requires_grad=True)
    (gradient,) = torch.autograd.grad(splat(gaussians, constant, camera).feature_map.sum(), constant)
    return gradient.squeeze(1)


def _squared_influence(target: Target, camera: Camera, generator: torch.Generator) -> Float[Tensor, " N"]:
    logits = target.gaussians["logit_opacities"].detach().requires_grad_()
    gaussians = Gaussians(target.gaussians.parameters | {"logit_opacities": logits})
    picture = target.method.render(gaussians, camera, wanted=(COVER,)).pictures[COVER]
    signs = torch.randint(0, 2, picture.shape, generator=generator) * 2.0 - 1
    (gradient,) = torch.autograd.grad((signs * picture).sum(), logits)
    # By the logit x the derivative is α (1 - α) times that by α.
    return (gradient / (1 - logits.detach().sigmoid()).clamp_min(SMALLEST)).square()
