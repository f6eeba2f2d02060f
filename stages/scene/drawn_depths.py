"""Enlarges scenes in small units before anything is trained in them.

The rasterizer draws nothing nearer than 0.2 units, whatever the unit. A close-up posed in metres would lie wholly or
partly in front of that plane, and train to an empty picture.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stages.scene.alignment import nearest_depth
from stages.scene.scene import Scene
from stages.scene.similarity import Similarity

NEAR = 0.2
"""`RasterSettings().near`, as a test checks. Not imported: changes of the rasterizer must not redo structure from
motion."""
AMPLE = 10 * NEAR
"""Nearest depth in an enlarged world: about that of COLMAP's worlds."""
CLOSEST = 2 * NEAR
"""Worlds with a smaller nearest depth are enlarged. That is a quantile: some surfaces are at half of it, and still
drawn."""


def drawn_scene(scene: Scene) -> tuple[Scene, float]:
    """The scene, enlarged if needed so that the rasterizer draws what its cameras see, and the factor applied.

    The scene itself and 1 if it is large enough, or if no camera sees a point.
    """
    nearest = nearest_depth(scene.cameras, scene.points)
    if not 0 < nearest < CLOSEST:
        return scene, 1.0
    factor = AMPLE / nearest
    return enlarged_scene(scene, factor), factor


def enlarged_scene(scene: Scene, factor: float) -> Scene:
    """The scene with cameras and points `factor` times as far from the origin: every picture stays the same."""
    grown = Similarity(factor, np.eye(3), np.zeros(3))
    cameras = replace(scene.cameras, world_to_camera=grown.world_to_camera(scene.cameras.world_to_camera))
    return replace(scene, cameras=cameras, points=scene.points * np.float32(factor))
