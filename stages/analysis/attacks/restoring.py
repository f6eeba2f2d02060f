"""What the owner, who has kept what he published, makes of an attacked container, whatever the attack was."""

from __future__ import annotations

from stages.analysis.attacks.target import Target
from stages.hiding.recovery import recovered


def restored_target(attacked: Target, published: Target, seed: int) -> Target:
    """The attacked container with what was done to all of it alike undone, in the published world.

    The owner is not told the attack, nor how far it moved the world. The scene decoder is the published one. The
    attacked target itself where there is nothing to undo, or where nothing of what was published is recognised.
    """
    recovery = recovered(attacked.gaussians, published.gaussians, seed)
    if recovery is None or not recovery.changed:
        return attacked
    return Target(recovery.gaussians, published.method)
