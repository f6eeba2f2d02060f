"""Restoration of an attacked container by its owner, who has kept the published one, whatever the attack was."""

from __future__ import annotations

from stages.analysis.attacks.target import Target
from stages.hiding.recovery import recovered


def restored_target(attacked: Target, published: Target, seed: int) -> Target:
    """The attacked container with every change undone that affects all Gaussians alike, in the published world.

    The owner does not know the attack, nor how it moved the world. The method, scene decoder included, is the published
    one. Returns `attacked` itself if there is nothing to undo, or if nothing of the published container is recognised.
    """
    recovery = recovered(attacked.gaussians, published.gaussians, seed)
    if recovery is None or not recovery.changed:
        return attacked
    return Target(recovery.gaussians, published.method)
