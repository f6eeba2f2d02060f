"""Choosing the similarity, of those that alignment proposes, that shows most of a message in the cover's pictures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from stages.hiding.rendering import AS_TRAINED, splat
from stages.scene.alignment import best, cameras_in_message_world, candidates, nearest_depth
from stages.scene.cameras import Camera, Cameras, depths_before, single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.message_views import LEGAL_COVERAGE
from stages.scene.scene import Scene
from stages.scene.similarity import Similarity

CLEAR_DEPTH = 0.5
"""Surfaces closer than this share of the nearest depth in the message's photos would be fog to the cover's cameras."""


def place(
    gaussians: Gaussians, message: Scene, cover: Scene, search_width: int, progress: Callable[[int, int], None]
) -> Similarity:
    """The similarity from the message's world to the cover's that shows the cover's cameras most of the message.

    Candidates are scored on pictures `search_width` pixels wide; `progress` receives the numbers of scored and of all
    candidates.
    """
    choices = candidates(cover.cameras, message.cameras, message.points, cover_points=cover.points)
    clear_from = clear_depth(message)

    def score(similarity: Similarity) -> tuple[int, float]:
        seen = cameras_in_message_world(cover.cameras, similarity)
        return coverage_score(clear_coverage(gaussians, seen, search_width, clear_from))

    return best(choices, score, progress)


def clear_depth(message: Scene) -> float:
    """The depth from which surfaces count, in the message's world units; 0 if its cameras see no sparse point."""
    return CLEAR_DEPTH * nearest_depth(message.cameras, message.points)


def shrunken(cameras: Cameras, width: int) -> Cameras:
    """The same cameras with pictures at most `width` pixels wide, for a quick look; pictures are never enlarged."""
    factor = min(1.0, width / cameras.width)
    return cameras.resized(max(1, round(cameras.width * factor)), max(1, round(cameras.height * factor)))


def clear_coverage(gaussians: Gaussians, cameras: Cameras, width: int, clear_from: float) -> Float32[np.ndarray, " V"]:
    """The share of each camera's picture that is filled by Gaussians at depth `clear_from` or beyond, in world units.

    The picture of a camera inside an object is filled, too, but by surfaces so close that no photo shows them so: such
    Gaussians occlude those behind them and do not count. Computed on pictures `width` pixels wide.
    """
    return coverage(gaussians, cameras, width, lambda camera, depths: depths >= clear_from)


Counting = Callable[[Camera, Float[Tensor, " N"]], Bool[Tensor, " N"]]
"""Which of N Gaussians count, given a camera and their depths in front of it in world units."""


@torch.no_grad()
def coverage(gaussians: Gaussians, cameras: Cameras, width: int, counts: Counting) -> Float32[np.ndarray, " V"]:
    """The share of each camera's picture filled by Gaussians that count; the others occlude what is behind them.

    Pictures are rendered `width` pixels wide, as samples of the whole picture: with the usual low-pass filter of 0.3
    square pixels, small Gaussians would swell at this size. For two scenes trained on large pictures, 48 of 800 pixels
    per row then showed up to 0.09 more coverage than there is, and up to 0.001 more with the adapted filter.
    """
    few = shrunken(cameras, width)
    settings = AS_TRAINED.for_fewer_pixels(few.width / cameras.width)
    shares = []
    for camera in single_cameras(few):
        counted = counts(camera, depths_before(gaussians.means, camera))
        features = counted.to(gaussians.means.dtype)[:, None]
        shares.append(float(splat(gaussians, features, camera, settings).feature_map.mean()))
    return np.array(shares, np.float32)


def coverage_score(coverages: Float[np.ndarray, " V"]) -> tuple[int, float]:
    """The number of legal views, then the mean coverage up to the legal limit, to a hundredth; higher is better.

    Coverage beyond the legal limit does not count: otherwise the message would be magnified until little of it is seen.
    """
    return int((coverages >= LEGAL_COVERAGE).sum()), round(float(coverages.clip(max=LEGAL_COVERAGE).mean()), 2)
