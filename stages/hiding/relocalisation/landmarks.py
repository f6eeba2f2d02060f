"""Landmarks: points of a scene by which pictures of it are recognised, found in renders of its Gaussians."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, Float64
from scipy.spatial.transform import Rotation

from stages.hiding.method import Method
from stages.hiding.rendering import COVER, splat
from stages.imaging.pictures import Picture, tensor_to_picture
from stages.scene.cameras import Camera, Cameras, depths_before, single_cameras
from stages.scene.even_spread import evenly_spread
from stages.scene.gaussians import Gaussians

MOST_VIEWS = 48
"""Number of the rig's views, evenly spread, whose renders are searched."""

TURNS = (0.0, 45.0, -45.0)
"""Degrees by which each of these cameras is also turned about its own vertical axis, to cover what lies beside the
pictures: all of bonsai's cameras look at its middle, and renders of other directions were not recognised."""

MOST_OF_A_VIEW = 250
"""Landmarks per view, the most pronounced first."""

LEAST_CONTRAST = 0.01
"""SIFT's contrast threshold; its default, 0.04, finds next to no landmarks in small, smooth renders."""

SMALL_PICTURE, ENLARGEMENT = 640, 2
"""Pictures whose longer side has at most `SMALL_PICTURE` pixels are enlarged by this factor first: SIFT's finest scale
is too coarse for them."""

SMALLEST_OPACITY = 0.5
"""A pixel with less opacity has no depth: the blended one is not that of any surface."""


@dataclass(frozen=True)
class Landmarks:
    """K points in world coordinates and their descriptors (`described`). K = 0 is allowed."""

    points: Float64[np.ndarray, "K 3"]
    descriptors: Float32[np.ndarray, "K 128"]


def landmarks(
    gaussians: Gaussians, method: Method, cameras: Cameras, after_each: Callable[[], None] = lambda: None
) -> Landmarks:
    """SIFT landmarks of the cover, from renders by at most `MOST_VIEWS` of the cameras, as they are and turned.

    Points are placed at the blended depth. `after_each` is called after each render.
    """
    turned = _turned(cameras)
    points, descriptors = [np.zeros((0, 3))], [np.zeros((0, 128), np.float32)]
    for row, camera in enumerate(single_cameras(turned)):
        with torch.no_grad():
            picture = tensor_to_picture(method.render(gaussians, camera, wanted=[COVER]).pictures[COVER])
        places, looks = described(picture, MOST_OF_A_VIEW)
        across, down = np.floor(places).astype(int).T
        depth, alpha = (each[down, across] for each in depths(gaussians, camera))
        seen = alpha > SMALLEST_OPACITY
        points.append(_lifted(places[seen], depth[seen], turned.intrinsics[row], turned.world_to_camera[row]))
        descriptors.append(looks[seen])
        after_each()
    return Landmarks(np.concatenate(points), np.concatenate(descriptors))


def _turned(cameras: Cameras) -> Cameras:
    chosen = evenly_spread(len(cameras), MOST_VIEWS)
    turns = np.tile(np.eye(4), (len(TURNS), 1, 1))
    turns[:, :3, :3] = Rotation.from_euler("y", np.array(TURNS)[:, None], degrees=True).as_matrix()
    poses = turns[:, None] @ cameras.world_to_camera[chosen]
    return replace(
        cameras,
        names=tuple(f"{cameras.names[row]} turned by {turn:g}" for turn in TURNS for row in chosen),
        world_to_camera=poses.reshape(-1, 4, 4),
        intrinsics=np.tile(cameras.intrinsics[chosen], (len(TURNS), 1, 1)),
    )


def described(picture: Picture, most: int) -> tuple[Float64[np.ndarray, "K 2"], Float32[np.ndarray, "K 128"]]:
    """SIFT keypoints in pixels (pixel centres at +0.5), at most `most`, and their RootSIFT descriptors.

    These are square roots of normalised histograms; their inner product is 1 for identical appearance (Arandjelović and
    Zisserman 2012).
    """
    grey = cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY)
    factor = ENLARGEMENT if max(grey.shape) <= SMALL_PICTURE else 1
    if factor > 1:
        grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    finder = cv2.SIFT_create(nfeatures=most, contrastThreshold=LEAST_CONTRAST)  # type: ignore[attr-defined]  # cv2's stub omits it
    found, histograms = finder.detectAndCompute(grey, None)
    if histograms is None:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    places = (np.array([each.pt for each in found], float) + 0.5) / factor
    places = places.clip(0, np.array(picture.shape[1::-1]) - 1e-3)
    return places, np.sqrt(histograms / histograms.sum(axis=1, keepdims=True)).astype(np.float32)


@torch.no_grad()
def depths(gaussians: Gaussians, camera: Camera) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """The depth along the optical axis, blended and divided by the blended opacity, and that opacity."""
    along = depths_before(gaussians.means, camera)
    rendering = splat(gaussians, along[:, None].contiguous(), camera)
    alphas = rendering.alphas.cpu()
    return (rendering.feature_map[..., 0].cpu() / alphas.clamp_min(1e-6)).numpy(), alphas.numpy()


def _lifted(
    places: Float64[np.ndarray, "K 2"],
    depth: Float[np.ndarray, " K"],
    intrinsics: Float64[np.ndarray, "3 3"],
    world_to_camera: Float64[np.ndarray, "4 4"],
) -> Float64[np.ndarray, "K 3"]:
    rays = np.concatenate([places, np.ones((len(places), 1))], axis=1) @ np.linalg.inv(intrinsics).T
    return (depth[:, None] * rays - world_to_camera[:3, 3]) @ world_to_camera[:3, :3]
