"""Worlds of small units, enlarged before anything is trained in them.

The rasterizer draws nothing nearer than a fifth of a unit, in whatever units: a close-up whose poses are in metres
would lie before that plane, wholly or with its front, and train to an empty picture.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stages.scene.alignment import nearest_depth
from stages.scene.scene import Scene
from stages.scene.similarity import Similarity

NEAR = 0.2
"""`RasterSettings().near`, as a test checks: no change of the rasterizer is to do structure from motion anew."""
AMPLE = 10 * NEAR
"""The depth from which on surfaces count in an enlarged world: about that of COLMAP's worlds."""
CLOSEST = 2 * NEAR
"""Some surfaces are nearer than the nearest depth, a quantile; half of it is still drawn."""


def drawn_scene(scene: Scene) -> tuple[Scene, float]:
    """The scene in a world that is large enough for what its cameras see to be drawn, and by what factor it grew.

    1, and the scene as it is, where it is already, and where no camera sees a point.
    """
    nearest = nearest_depth(scene.cameras, scene.points)
    if not 0 < nearest < CLOSEST:
        return scene, 1.0
    factor = AMPLE / nearest
    return enlarged_scene(scene, factor), factor


def enlarged_scene(scene: Scene, factor: float) -> Scene:
    """Cameras and points `factor` times as far from the origin: every picture stays as it was."""
    grown = Similarity(factor, np.eye(3), np.zeros(3))
    cameras = replace(scene.cameras, world_to_camera=grown.world_to_camera(scene.cameras.world_to_camera))
    return replace(scene, cameras=cameras, points=scene.points * np.float32(factor))
