"""Enlarging messages whose world units are small, before the cover's cameras look at them.

The rasterizer draws nothing nearer than 0.2 units, whatever a unit is. Splats from a world of their own, such as an
object of a tenth of a unit in metres, would lie wholly or partly in front of that near plane.
"""

from __future__ import annotations

from stages.hiding.placing import clear_depth
from stages.hiding.placing_alone import CLEAR_RADII, middle_and_radius
from stages.scene.drawn_depths import AMPLE, NEAR, enlarged_scene
from stages.scene.gaussians import Gaussians
from stages.scene.scene import Scene
from stages.scene.world_scale import scaled


def enlarged(gaussians: Gaussians, message: Scene | None) -> tuple[Gaussians, Scene | None, float]:
    """N > 0 Gaussians and their scene, if any, in a world that is large enough, and the factor of enlargement.

    The factor is 1, and nothing changes, if everything far enough from the cameras to count is beyond the near plane;
    that held for all of COLMAP's worlds so far. View-dependent colours do not change with the size.
    """
    clear_from = clear_depth(message) if message is not None else 0.0
    if not clear_from:
        clear_from = CLEAR_RADII * middle_and_radius(gaussians)[1]
    if clear_from >= NEAR:
        return gaussians, message, 1.0
    factor = AMPLE / clear_from
    scene = None if message is None else enlarged_scene(message, factor)
    return scaled(gaussians, factor), scene, factor
