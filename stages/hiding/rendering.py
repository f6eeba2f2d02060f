"""The rendering of one camera: pictures, and the rasterizer's output that density control uses."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float, Int
from torch import Tensor

from opencl.rasterizer import RasterSettings, rasterize
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians
from stages.timing.stopwatch import backward_of, part

ACTIVATIONS = "activations"
RASTERIZER = "rasterizer"
"""Parts of an iteration for the stopwatch; methods define others."""

AS_TRAINED = RasterSettings()
"""3DGS's constants, with which every container is trained and rendered."""

COVER = "cover"
"""The cover's name among the pictures of a rendering; every other name is a message's."""


@dataclass(frozen=True)
class Rendering:
    """One camera's pictures by name, unclamped [H, W, 3], and the rasterizer's output.

    `feature_map` [H, W, M] is what was blended, before any decoder: F_coup of Eq. 4. Methods without features blend the
    cover's picture itself; `sh` blends those of all messages along with it. After backward, the gradient of `means2d`
    is the screen-space gradient, in pixels.
    """

    pictures: dict[str, Float[Tensor, "H W 3"]]
    feature_map: Float[Tensor, "H W M"]
    alphas: Float[Tensor, "H W"]
    radii: Int[Tensor, " N"]
    means2d: Float[Tensor, "N 2"]


def splat(
    gaussians: Gaussians, features: Float[Tensor, "N M"], camera: Camera, settings: RasterSettings = AS_TRAINED
) -> Rendering:
    """Blend the features of all Gaussians for one camera (Eq. 3 and 4); `pictures` is still empty.

    Without Gaussians, everything is zero.
    """
    scales, opacities = gaussians.scales, gaussians.opacities
    backward_of(ACTIVATIONS, scales, opacities)
    with part(RASTERIZER):
        out = rasterize(
            gaussians.means,
            gaussians["quats"],
            scales,
            opacities,
            features,
            camera.world_to_camera,
            camera.intrinsics,
            camera.width,
            camera.height,
            settings=settings,
        )
    backward_of(RASTERIZER, out.features, out.alphas)
    return Rendering({}, out.features, out.alphas, out.radii, out.means2d)
