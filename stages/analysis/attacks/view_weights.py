"""Pruning of Gaussians with large blending weights but little influence on the decoded cover.

GSPure (AAAI 2026) clusters Gaussians by their weights in views and prunes those that serve the message. We know only
this idea, not its code: weights, influences, clusters and the pruning order are defined below.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.cluster.vq import kmeans2
from torch import Tensor

from stages.analysis.attacks.target import Attacker, Knowledge, Target
from stages.analysis.random_signs import random_signs
from stages.hiding.rendering import COVER, splat
from stages.scene.cameras import Camera
from stages.scene.even_spread import evenly_spread
from stages.scene.gaussians import Gaussians

CLUSTERS = 128
MOST_VIEWS = 64
"""Weights and influences are summed over at most this many training views, evenly spread."""

SMALLEST = 1e-6
"""Floor of weights and influences, in pixels; smaller ones count as equal."""


@dataclass(frozen=True)
class Weights:
    """Two values of each Gaussian, over the pixels of all views.

    `weight` is its blending weight, Σ T α. `influence` is how much the decoded cover would change without it: to first
    order, the root of the sum of squared changes.
    """

    weight: Float[Tensor, " N"]
    influence: Float[Tensor, " N"]


class ViewWeights:
    """The weights of the target that was asked for last: blending weights once, and influences once for each seed.

    Attacks that share one of these share what they learn of a target. It holds that target, and what was learnt, until
    another is asked for.
    """

    def __init__(self) -> None:
        self._asked_for: tuple[Target, Knowledge] | None = None
        self._weight = torch.zeros(0)
        self._influences: dict[int, Float[Tensor, " N"]] = {}

    def __call__(self, target: Target, seed: int, knowledge: Knowledge) -> Weights:
        """The weights and influences of all Gaussians, on the CPU."""
        if self._asked_for is None or self._asked_for[0] is not target or self._asked_for[1] is not knowledge:
            self._weight, self._influences = blending_weights(target, knowledge), {}
            self._asked_for = target, knowledge
        if seed not in self._influences:
            self._influences[seed] = influences(target, seed, knowledge)
        return Weights(self._weight, self._influences[seed])


def view_weight_pruning(weights_of: ViewWeights) -> Callable[[Target, int, Knowledge], Attacker]:
    """Prune this share of the Gaussians, those that cost the cover least for the blending weight they remove.

    The attacker knows the container, including its scene decoder, and the training cameras. Squared errors of pruned
    Gaussians roughly add up, and so do weights: in ascending order of influence² / weight, each step removes the most
    blending weight for the next bit of error in the cover. Gaussians that no view shows go first, since neither
    picture needs them.
    """

    def prepare(target: Target, seed: int, knowledge: Knowledge) -> Attacker:
        weights = weights_of(target, seed, knowledge)
        return _pruned(target, pruning_order(weights, torch.arange(len(target.gaussians))))

    return prepare


def view_weight_clustering(weights_of: ViewWeights) -> Callable[[Target, int, Knowledge], Attacker]:
    """Prune like `view_weight_pruning`, but cluster by cluster, as GSPure does.

    The clusters come from k-means on the logarithms of weight and influence; a cluster costs the sum over its
    Gaussians. Pruning one by one is at least as strong, by 0.2 dB on average over three captures: the estimates do not
    need the averaging that clusters provide.
    """

    def prepare(target: Target, seed: int, knowledge: Knowledge) -> Attacker:
        weights = weights_of(target, seed, knowledge)
        return _pruned(target, pruning_order(weights, clusters(weights, seed)))

    return prepare


def blending_weights(target: Target, knowledge: Knowledge) -> Float[Tensor, " N"]:
    """The blending weights of all Gaussians: for each view, the gradient of the sum of a blended constant.

    They are worked out on the attacker's device; the result is on the CPU.
    """
    there, cameras = target.on(knowledge.device), knowledge.views.cameras
    weight = torch.zeros(len(target.gaussians), device=knowledge.device)
    for view in evenly_spread(len(cameras), MOST_VIEWS):
        weight += _blending_weights(there.gaussians, cameras[view])
        knowledge.after_each()
    return weight.cpu()


def influences(target: Target, seed: int, knowledge: Knowledge) -> Float[Tensor, " N"]:
    """The influences of all Gaussians, from a backward pass for each view.

    The influence of opacity α_i is a Hutchinson estimate: with a random sign z for each colour of each pixel, the
    expected square of α_i ∂(z · cover)/∂α_i is the sum of squares over pixels. It is worked out on the attacker's
    device; the result is on the CPU.
    """
    generator = torch.Generator().manual_seed(seed)
    there, cameras = target.on(knowledge.device), knowledge.views.cameras
    squares = torch.zeros(len(target.gaussians), device=knowledge.device)
    for view in evenly_spread(len(cameras), MOST_VIEWS):
        squares += _squared_influence(there, cameras[view], generator)
        knowledge.after_each()
    return squares.sqrt().cpu()


def pruning_order(weights: Weights, labels: Int[Tensor, " N"]) -> Int[Tensor, " N"]:
    """The rows of all Gaussians in pruning order: first unseen ones, then clusters (`labels`), and the Gaussians within
    each cluster, by ascending influence² / weight."""
    count = int(labels.max()) + 1 if len(labels) else 0
    costs = torch.stack([weights.influence.square(), weights.weight]).double()
    totals = torch.zeros(2, count, dtype=costs.dtype).index_add(1, labels, costs)
    ratio, own = (each[0] / each[1].clamp_min(SMALLEST) for each in (totals, costs))
    seen = (weights.weight > SMALLEST).numpy()
    order = np.lexsort([own.numpy(), labels.numpy(), ratio[labels].numpy(), seen])
    return torch.from_numpy(order)


def clusters(weights: Weights, seed: int) -> Int[Tensor, " N"]:
    """A cluster label from 0 to `CLUSTERS` - 1 for each Gaussian; clusters may be empty, and N may be 0 or 1."""
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
    constant = torch.ones(len(gaussians), 1, device=gaussians.means.device, requires_grad=True)
    (gradient,) = torch.autograd.grad(splat(gaussians, constant, camera).feature_map.sum(), constant)
    return gradient.squeeze(1)


def _squared_influence(target: Target, camera: Camera, generator: torch.Generator) -> Float[Tensor, " N"]:
    logits = target.gaussians["logit_opacities"].detach().requires_grad_()
    gaussians = target.gaussians.with_parameters({"logit_opacities": logits})
    picture = target.method.render(gaussians, camera, wanted=(COVER,)).pictures[COVER]
    (gradient,) = torch.autograd.grad((random_signs(picture, generator) * picture).sum(), logits)
    # With respect to the logit, the derivative is α (1 - α) times the one with respect to α.
    return (gradient / (1 - logits.detach().sigmoid()).clamp_min(SMALLEST)).square()
