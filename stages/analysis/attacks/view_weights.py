"""Pruning of Gaussians that weigh much in what is blended and little in what the cover shows.

GSPure (AAAI 2026) clusters Gaussians by their weights in views and prunes what serves the message. Only that idea is
known here, not its code: weights, influences, clusters and their order are as written below.
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
from stages.scene.even_spread import evenly_spread
from stages.scene.gaussians import Gaussians

CLUSTERS = 128
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
    """Prune the share of the Gaussians whose going costs the cover least for the weight that goes with them.

    The attacker knows the container, its scene decoder included, and where the training cameras stood. Squared errors
    of what is pruned add up, roughly, and so do weights: with influence² / weight ascending, each step takes most of
    what is blended for the cover's next bit of error. Gaussians that no view shows go first: neither picture needs
    them.
    """
    weights = view_weights(target, seed, knowledge)
    return _pruned(target, pruning_order(weights, torch.arange(len(target.gaussians))))


def view_weight_clustering(target: Target, seed: int, knowledge: Knowledge) -> Attacker:
    """The same cluster by cluster, as GSPure prunes: k-means on the logarithms of weight and influence.

    What a cluster costs is the sum over its Gaussians. One by one is the stronger attack, by 0.3 dB on the fox; what
    clusters are for, to even out estimates, is not needed here.
    """
    weights = view_weights(target, seed, knowledge)
    return _pruned(target, pruning_order(weights, clusters(weights, seed)))


def view_weights(target: Target, seed: int, knowledge: Knowledge) -> Weights:
    """By two backward passes a view.

    The weights are the gradient of the sum of a blended constant. The influence of opacity α_i is estimated as by
    Hutchinson: with a random sign z for each colour of each pixel, the square of α_i ∂(z · cover)/∂α_i is on average
    the sum of squares over pixels.
    """
    generator = torch.Generator().manual_seed(seed)
    cameras = knowledge.views.cameras
    weight, squares = torch.zeros(len(target.gaussians)), torch.zeros(len(target.gaussians))
    for view in evenly_spread(len(cameras), MOST_VIEWS):
        weight += _blending_weights(target.gaussians, cameras[view])
        squares += _squared_influence(target, cameras[view], generator)
        knowledge.after_each()
    return Weights(weight, squares.sqrt())


def pruning_order(weights: Weights, labels: Int[Tensor, " N"]) -> Int[Tensor, " N"]:
    """The rows of all Gaussians in the order in which they are pruned: clusters by what they cost, the Gaussians of
    each by what they do."""
    count = int(labels.max()) + 1 if len(labels) else 0
    costs = torch.stack([weights.influence.square(), weights.weight]).double()
    totals = torch.zeros(2, count, dtype=costs.dtype).index_add(1, labels, costs)
    ratio, own = (each[0] / each[1].clamp_min(SMALLEST) for each in (totals, costs))
    seen = (weights.weight > SMALLEST).numpy()
    order = np.lexsort([own.numpy(), labels.numpy(), ratio[labels].numpy(), seen])
    return torch.from_numpy(order)


def clusters(weights: Weights, seed: int) -> Int[Tensor, " N"]:
    """A label for each Gaussian, at most `CLUSTERS` of them; empty clusters are no harm, nor are fewer than two."""
    values = torch.stack([weights.weight, weights.influence], dim=1).clamp_min(SMALLEST).log().double()
    if len(values) < 2:
        return torch.zeros(len(values), dtype=torch.long)
    standardised = ((values - values.mean(dim=0)) / values.std(dim=0).clamp_min(SMALLEST)).numpy()
    count = min(CLUSTERS, len(np.unique(standardised, axis=0)))
    _, labels = kmeans2(standardised, count, minit="++", seed=np.random.default_rng(seed), missing="warn")
    return torch.from_numpy(labels).long()


def _pruned(target: Target, order: Int[Tensor, " N"]) -> Attacker:
    return lambda share: target.keeping(order[round(share * len(order)) :].sort().values)


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
