"""Which of the similarities that alignment proposes shows most of a message in the cover's pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from stages.hiding.rendering import AS_TRAINED, splat
from stages.scene.alignment import best, cameras_in_message_world, candidates, nearest_depth
from stages.scene.cameras import Camera, Cameras, single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.message_views import LEGAL_COVERAGE
from stages.scene.scene import Scene
from stages.scene.similarity import Similarity

CLEAR_DEPTH = 0.5
"""Surfaces closer than this share of the nearest that the message's photos show are fog to the cover's cameras."""


def place(
    gaussians: Gaussians, message: Scene, cover: Scene, search_width: int, progress: Callable[[int, int], None]
) -> Similarity:
    """From the message's world into the cover's, so that the cover's cameras see as much of the message as possible.

    Candidates are scored on `search_width` pixels of a row; `progress` takes how many of how many are.
    """
    choices = candidates(cover.cameras, message.cameras, message.points, cover_points=cover.points)
    clear_from = clear_depth(message)
    scored = 0

    def score(similarity: Similarity) -> tuple[int, float]:
        nonlocal scored
        scored += 1
        progress(scored, len(choices))
        seen = cameras_in_message_world(cover.cameras, similarity)
        return coverage_score(clear_coverage(gaussians, seen, search_width, clear_from))

    return best(choices, score)


def clear_depth(message: Scene) -> float:
    """From which depth on surfaces count, in the message's units; 0 where its cameras see no point."""
    return CLEAR_DEPTH * nearest_depth(message.cameras, message.points)


def shrunken(cameras: Cameras, width: int) -> Cameras:
    """The same cameras with pictures `width` pixels wide, for a quick look; never wider than they were."""
    factor = min(1.0, width / cameras.width)
    size = (max(1, round(cameras.width * factor)), max(1, round(cameras.height * factor)))
    scaling = np.diag([size[0] / cameras.width, size[1] / cameras.height, 1.0])
    return replace(cameras, intrinsics=scaling @ cameras.intrinsics, width=size[0], height=size[1])


def clear_coverage(gaussians: Gaussians, cameras: Cameras, width: int, clear_from: float) -> Float32[np.ndarray, " V"]:
    """The share of each camera's picture that Gaussians fill from the depth `clear_from` on, in world units.

    A camera inside of things has its picture filled, too, but by what stands so close that no photo shows it so: such
    Gaussians hide what is behind them and count nothing. Looked at in `width` pixels a row.
    """
    return coverage(gaussians, cameras, width, lambda camera, depths: depths >= clear_from)


Counting = Callable[[Camera, Float[Tensor, " N"]], Bool[Tensor, " N"]]
"""Which of N Gaussians count, seen from a camera and as far in front of it as their depths say, in world units."""


@torch.no_grad()
def coverage(gaussians: Gaussians, cameras: Cameras, width: int, counts: Counting) -> Float32[np.ndarray, " V"]:
    """The share of each camera's picture that Gaussians fill which count; the others hide what is behind them.

    Only `width` pixels of a row are looked at, as they are in the whole picture: with the usual low-pass of 0.3 square
    pixels, of these few, small Gaussians would swell. Of two scenes trained on large pictures 48 of 800 pixels then
    showed up to 0.09 more than is filled, so up to 0.001.
    """
    few = shrunken(cameras, width)
    settings = AS_TRAINED.for_fewer_pixels(few.width / cameras.width)
    shares = []
    for camera in single_cameras(few):
        towards = camera.world_to_camera[2].to(gaussians.device)
        counted = counts(camera, gaussians.means @ towards[:3] + towards[3])
        features = counted.to(gaussians.means.dtype)[:, None]
        shares.append(float(splat(gaussians, features, camera, settings).feature_map.mean()))
    return np.array(shares, np.float32)


def coverage_score(coverage: Float32[np.ndarray, " V"]) -> tuple[int, float]:
    """Legal views first, then how nearly legal the others are, to a hundredth: higher is better.

    Coverage beyond what is legal counts nothing, or the message would be magnified until little of it is seen.
    """
    return int((coverage >= LEGAL_COVERAGE).sum()), round(float(coverage.clip(max=LEGAL_COVERAGE).mean()), 2)
