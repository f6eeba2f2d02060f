"""Refining a picture's camera: it is moved until a render from there agrees with the picture in every pixel."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float64
from scipy.spatial.transform import Rotation

from stages.hiding.method import Method
from stages.hiding.relocalisation.landmarks import SMALLEST_OPACITY, depths
from stages.hiding.rendering import COVER
from stages.imaging.pictures import Picture, tensor_to_picture
from stages.scene.cameras import Cameras, single_cameras
from stages.scene.gaussians import Gaussians

BLURS = (3.0, 2.0, 1.2, 0.7, 0.5)
"""Standard deviations in pixels, one per step: coarse ones first, for a wider basin of convergence; the last is
repeated until convergence."""

MOST_STEPS = 14
MOST_ZOOMED = 3.0
"""The largest change of a focal length, as a logarithm; steps that go further have lost the scene."""
"""In total; from a good start, the first seven are enough."""

STILL = 0.05
"""Convergence threshold in pixels, for the median displacement of a step over all pixels."""

FAR = 0.5
"""Median displacement of a step, in pixels, above which depth is rendered again."""

BORDER = 4
"""Width in pixels of the margin that is not compared: blur mixes in what lies beyond the edge."""

LEAST_NOISE = 0.5
"""Difference in levels of 255 between picture and render of a perfectly aligned camera."""

DAMPING = 1e-6
"""Damping of the normal equations, whose columns are normalised: parameters that the picture does not determine stay
unchanged."""

Flow = tuple[Float64[np.ndarray, "H W 9"], Float64[np.ndarray, "H W 9"]]


def aligned(picture: Picture, gaussians: Gaussians, method: Method, start: Cameras) -> Cameras:
    """The single camera of `start`, with pose, focal length and principal point refined to match the picture.

    Gauss-Newton steps on the luminance of blurred pictures, with free brightness and contrast. Pixels that differ much,
    for reasons other than the camera, get small weights; those without depth, where little is drawn, get none. Steps
    that run away end the search: the camera from before them is returned.
    """
    target = _grey(picture)
    world_to_camera, intrinsics = start.world_to_camera[0].copy(), start.intrinsics[0].copy()
    depth, drawn, moved_by = np.zeros_like(target), np.zeros(target.shape, bool), np.inf
    for blur in (*BLURS, *[BLURS[-1]] * (MOST_STEPS - len(BLURS))):
        cameras = replace(start, world_to_camera=world_to_camera[None], intrinsics=intrinsics[None])
        camera = single_cameras(cameras)[0]
        if moved_by > FAR:
            depth, alpha = (each.astype(np.float64) for each in depths(gaussians, camera))
            drawn = alpha > SMALLEST_OPACITY
        with torch.no_grad():
            shown = tensor_to_picture(method.render(gaussians, camera, wanted=[COVER]).pictures[COVER])
        flow = _flow(depth, drawn, intrinsics)
        step = _step(target, _grey(shown), flow, drawn, blur)
        turned = np.eye(4)
        turned[:3, :3], turned[:3, 3] = Rotation.from_rotvec(step[3:6]).as_matrix(), step[:3]
        world_to_camera = turned @ world_to_camera
        intrinsics[[0, 1], [0, 1]] *= np.exp(step[6])
        intrinsics[:2, 2] += step[7:9]
        if _ran_away(world_to_camera, intrinsics, start):
            return cameras
        moved_by = float(np.median(np.hypot(flow[0] @ step, flow[1] @ step)[drawn])) if drawn.any() else 0.0
        if blur == BLURS[-1] and moved_by < STILL:
            break
    return replace(start, world_to_camera=world_to_camera[None], intrinsics=intrinsics[None])


def _ran_away(
    world_to_camera: Float64[np.ndarray, "4 4"], intrinsics: Float64[np.ndarray, "3 3"], start: Cameras
) -> bool:
    """Whether a camera is none that could have taken the picture, or that can be rendered in float32."""
    with np.errstate(over="ignore"):
        single = [each.astype(np.float32) for each in (world_to_camera, intrinsics)]
    finite = all(np.isfinite(each).all() for each in single)
    return not finite or abs(np.log(intrinsics[0, 0] / start.intrinsics[0, 0, 0])) > MOST_ZOOMED


def _grey(picture: Picture) -> Float64[np.ndarray, "H W"]:
    return cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY).astype(np.float64)


def _step(
    target: Float64[np.ndarray, "H W"],
    shown: Float64[np.ndarray, "H W"],
    flow: Flow,
    drawn: Bool[np.ndarray, "H W"],
    blur: float,
) -> Float64[np.ndarray, " 9"]:
    """One step: translation along the camera's axes, rotation vector, log focal length, principal point in pixels."""
    render, wanted = (cv2.GaussianBlur(each, (0, 0), blur) for each in (shown, target))
    slopes = [cv2.Sobel((render + wanted) / 2, -1, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1))]
    change = -(slopes[0][..., None] * flow[0] + slopes[1][..., None] * flow[1])
    columns = np.concatenate([change, render[..., None], np.ones((*render.shape, 1))], axis=-1).reshape(render.size, -1)
    errors = (wanted - render).ravel()
    weights = (_weights(errors.reshape(render.shape)) * drawn).ravel()
    lengths = np.sqrt((columns**2 * weights[:, None]).sum(axis=0)) + 1e-12
    scaled = columns / lengths
    normal = scaled.T @ (scaled * weights[:, None]) + DAMPING * np.eye(scaled.shape[1])
    return (np.linalg.solve(normal, scaled.T @ (weights * errors)) / lengths)[:9]


def _weights(errors: Float64[np.ndarray, "H W"]) -> Float64[np.ndarray, "H W"]:
    """Cauchy weights of the errors relative to their spread; 0 along the edges of the picture."""
    spread = 1.4826 * np.median(np.abs(errors)) + LEAST_NOISE
    weights = np.zeros_like(errors)
    inside = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    weights[inside] = 1 / (1 + (errors[inside] / (2 * spread)) ** 2)
    return weights


def _flow(
    depth: Float64[np.ndarray, "H W"], drawn: Bool[np.ndarray, "H W"], intrinsics: Float64[np.ndarray, "3 3"]
) -> Flow:
    """The derivatives of each pixel's position, horizontal and vertical, by the nine parameters of a step.

    A depth of 0 where nothing is drawn would make translation seem to move that pixel without end: it is taken to be
    infinite there.
    """
    height, width = depth.shape
    down, across = np.mgrid[0:height, 0:width] + 0.5
    x, y = (across - intrinsics[0, 2]) / intrinsics[0, 0], (down - intrinsics[1, 2]) / intrinsics[1, 1]
    near, none, one = np.where(drawn, 1 / np.maximum(depth, 1e-6), 0), np.zeros_like(x), np.ones_like(x)
    horizontal = [near, none, -x * near, -x * y, 1 + x * x, -y, x]
    vertical = [none, near, -y * near, -(1 + y * y), x * y, x, y]
    return (
        np.stack([*(intrinsics[0, 0] * each for each in horizontal), one, none], axis=-1),
        np.stack([*(intrinsics[1, 1] * each for each in vertical), none, one], axis=-1),
    )
