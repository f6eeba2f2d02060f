"""Rigid motion: the container's world is rotated as a whole, and its cameras with it."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import cast

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from stages.analysis.attacks.target import Target, ToldDirections
from stages.hiding.method import Method
from stages.hiding.networks import SCENE_DECODER
from stages.scene.moved_splats import moved
from stages.scene.similarity import Similarity

SEVERITIES = (5.0, 15.0, 45.0, 90.0, 180.0)


def rigid_motion(target: Target, degrees: float, generator: torch.Generator) -> Target:
    """Rotate the world about a random axis through the median of the means by this many degrees.

    Everything public rotates with it: means, quaternions, harmonics, and the scene decoder's reading of viewing
    directions, if it has one. From the rotated cameras the cover therefore looks as before. A message decoder that
    reads viewing directions still gets them in world coordinates. The attacker knows only the container.
    """
    axis = torch.randn(3, generator=generator, dtype=torch.float64)
    turn = torch.nn.functional.normalize(axis, dim=0).numpy() * np.deg2rad(degrees)
    rotation = Rotation.from_rotvec(turn).as_matrix()
    means = target.gaussians.means
    centre = (means.median(dim=0).values if len(means) else means.new_zeros(3)).double().numpy()
    return _moved(target, Similarity(1.0, rotation, centre - rotation @ centre))


def _moved(target: Target, motion: Similarity) -> Target:
    return replace(
        target,
        gaussians=moved(target.gaussians, motion),
        method=_turned_method(target.method, motion),
        motion=motion.compose(target.motion),
    )


def _turned_method(method: Method, motion: Similarity) -> Method:
    """The method; if its scene decoder reads viewing directions, a copy that reads rotated ones as the old ones."""
    if not isinstance(method.networks.get(SCENE_DECODER), ToldDirections):
        return method
    turned = copy.deepcopy(method)
    cast(ToldDirections, turned.networks[SCENE_DECODER]).turn_view(motion.rotation)
    return turned
