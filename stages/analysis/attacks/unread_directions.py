"""Removal of what features hold along directions that the scene decoder ignores, which the cover does not need."""

from __future__ import annotations

import torch
from jaxtyping import Float64
from torch import Tensor

from stages.analysis.attacks.features import reads_centred, shrunk
from stages.analysis.attacks.target import Attacker, Knowledge, Target
from stages.analysis.random_signs import random_signs
from stages.hiding.coupled import FEATURES
from stages.hiding.rendering import COVER
from stages.hiding.stored_features import stored
from stages.scene.cameras import Camera
from stages.scene.even_spread import evenly_spread

MOST_VIEWS = 16
"""At most this many training views, evenly spread, probe the scene decoder."""

SMALLEST_VARIANCE = 1e-8
"""Floor of the features' variance along a direction; with less, all features count as equal there."""


def unread_directions(target: Target, seed: int, knowledge: Knowledge) -> Attacker:
    """Set features to their mean along as many directions as the severity says, those that affect the cover least.

    The attacker knows the container, including its scene decoder, and the training cameras. The directions are
    eigenvectors of the scene decoder's JᵀJ over whitened features, in ascending order of their eigenvalues: to first
    order, this changes the cover least in the mean square. (With directions from the decoder's first layer alone,
    bringing GS-Hider's message to 17.5 dB costs its cover 3.1 dB instead of 1.3, on the fox.) The scene decoder of
    `homogeneous` reads 8 of its 16 directions, so the other 8 can be removed without a trace. The decoder must be a
    `FollowsFeatures`.
    """
    centred = target.gaussians[FEATURES].double().sigmoid() - 0.5
    mean = centred.mean(dim=0)
    spread, basis = torch.linalg.eigh((centred - mean).T @ (centred - mean) / max(1, len(centred)))
    root = basis * spread.clamp_min(SMALLEST_VARIANCE).sqrt() @ basis.T
    _, ascending = torch.linalg.eigh(root @ sensitivity(target, seed, knowledge) @ root)

    def removed(count: float) -> Target:
        unread = ascending[:, : int(count)]
        left = centred - (centred - mean) @ (root @ unread @ unread.T @ torch.linalg.inv(root)).T
        if reads_centred(target.method):
            return shrunk(target, left, torch.eye(len(root), dtype=root.dtype))
        return target.with_parameters({FEATURES: stored(0.5 + left)})

    return removed


def sensitivity(target: Target, seed: int, knowledge: Knowledge) -> Float64[Tensor, "M M"]:
    """JᵀJ of the scene decoder, summed over pixels and views: how much the cover changes along feature directions.

    A Hutchinson estimate: from gradients of the cover's sum with a random sign for each colour of each pixel. It is
    worked out on the attacker's device; the result is on the CPU.
    """
    generator = torch.Generator().manual_seed(seed)
    cameras = knowledge.views.cameras
    channels = target.gaussians[FEATURES].shape[1]
    total = torch.zeros(channels, channels, dtype=torch.float64, device=knowledge.device)
    there = target.on(knowledge.device)
    for view in evenly_spread(len(cameras), MOST_VIEWS):
        gradient = _gradient(there, cameras[view], generator)
        total += gradient.T @ gradient
        knowledge.after_each()
    return total.cpu()


def _gradient(target: Target, camera: Camera, generator: torch.Generator) -> Float64[Tensor, "P M"]:
    """The gradient of the cover's randomly signed sum with respect to the feature map."""
    raw = target.gaussians[FEATURES].detach().requires_grad_()
    rendering = target.method.render(target.gaussians.with_parameters({FEATURES: raw}), camera, wanted=(COVER,))
    picture = rendering.pictures[COVER]
    [gradient] = torch.autograd.grad((random_signs(picture, generator) * picture).sum(), rendering.feature_map)
    return gradient.flatten(0, 1).double()
