"""How much larger the world of a scene, and of splats trained in it, is than that of the poses it came with.

1 unless poses in small units were enlarged (`drawn_depths`). Anything else that came with these poses, such as splats
trained elsewhere, is in the smaller world.
"""

from __future__ import annotations

import math

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from stages.scene.gaussians import Gaussians

WORLD_SCALE = "world_scale"
"""Attribute of `scene` and `splats` with that factor, if it is not 1."""


def world_scale_of(artifact: Artifact) -> float:
    """The factor that a `scene` or `splats` states, or 1. Raises `UserError` unless it is a positive number."""
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
    """The attributes to write; none for 1."""
    return {} if scale == 1 else {WORLD_SCALE: scale}


def scaled(gaussians: Gaussians, factor: float) -> Gaussians:
    """Gaussians in a world that is `factor` times as large; view-dependent colours stay as they are."""
    grown = {"means": gaussians.means * factor, "log_scales": gaussians["log_scales"] + math.log(factor)}
    return gaussians.with_parameters(grown)


def refuse_other_world(gaussians: Artifact, scene: Artifact) -> None:
    """Raise `UserError` for splats in another world than the scene from whose cameras they are to be drawn.

    Containers are in that of the scene with which they were made, and do not state it.
    """
    if gaussians.kind == "splats" and world_scale_of(gaussians) != world_scale_of(scene):
        raise UserError(
            "the splats are not in the world of the cameras",
            where=gaussians.path,
            found=f"a world {world_scale_of(gaussians):g} times as large as that of the poses they came with",
            expected=f"one {world_scale_of(scene):g} times as large, as the scene's",
            remedy="Train splats on this scene, or give the scene on which these were trained.",
        )
