"""Messages of small world units, enlarged before the cover's cameras look at them.

The rasterizer draws nothing nearer than a fifth of a unit, in whatever units: splats that came with a world of their
own, a thing of a tenth of a unit in metres say, would lie before that plane, wholly or with their fronts.
"""

from __future__ import annotations

from stages.hiding.placing import clear_depth
from stages.hiding.placing_alone import CLEAR_RADII, middle_and_radius
from stages.scene.drawn_depths import AMPLE, NEAR, enlarged_scene
from stages.scene.gaussians import Gaussians
from stages.scene.scene import Scene
from stages.scene.world_scale import scaled


def enlarged(gaussians: Gaussians, message: Scene | None) -> tuple[Gaussians, Scene | None, float]:
    """N > 0 Gaussians and the scene that came with them, if any, in a world that is large enough, and by what factor.

    1, and both as they are, where what is clear of the cameras lies beyond what is drawn: so it was in all worlds of
    COLMAP. Colours that depend on the direction do not change with the size.
    """
    clear_from = clear_depth(message) if message is not None else 0.0
    if not clear_from:
        clear_from = CLEAR_RADII * middle_and_radius(gaussians)[1]
    if clear_from >= NEAR:
        return gaussians, message, 1.0
    factor = AMPLE / clear_from
    scene = None if message is None else enlarged_scene(message, factor)
    return scaled(gaussians, factor), scene, factor
