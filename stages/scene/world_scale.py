"""By how much the world of a scene, and of splats trained in it, is larger than that of the poses that it came with.

1 but where poses of small units were enlarged (`drawn_depths`). Whatever else came with these poses, such as splats
that were trained elsewhere, stands in the smaller world.
"""

from __future__ import annotations

import math

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from stages.scene.gaussians import Gaussians

WORLD_SCALE = "world_scale"
"""The attribute of `scene` and `splats` that says so, where it is not 1."""


def world_scale_of(artifact: Artifact) -> float:
    """What a `scene` or `splats` says, or 1. Raises `UserError` for what is no positive number."""
    found = artifact.attributes.get(WORLD_SCALE, 1.0)
    if isinstance(found, bool) or not isinstance(found, int | float) or not 0 < found < math.inf:
        raise UserError(
            f"the {WORLD_SCALE} of a {artifact.kind} is not what it should be",
            where=artifact.path,
            found=repr(found)[:80],
            expected="a positive number",
            remedy="the artifact was not made by this version; make it again",
        )
    return float(found)


def stated(scale: float) -> dict[str, float]:
    """The attributes to write."""
    return {} if scale == 1 else {WORLD_SCALE: scale}


def scaled(gaussians: Gaussians, factor: float) -> Gaussians:
    """Gaussians in a world that is `factor` times as large; colours that depend on the direction stay as they are."""
    grown = {"means": gaussians.means * factor, "log_scales": gaussians["log_scales"] + math.log(factor)}
    return Gaussians(gaussians.parameters | grown)
