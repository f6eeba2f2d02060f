"""Grain read off a picture by its owner, who has the container from before and knows how the coins fell."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.artifact import Artifact
from stages.hiding.key import key_generator
from stages.hiding.method import Method
from stages.hiding.relocalisation.alignment import aligned
from stages.hiding.relocalisation.landmarks import landmarks
from stages.hiding.relocalisation.recognition import recognised
from stages.hiding.storage import read_gaussians, read_method
from stages.hiding.watermark.coins import standard_score, with_decoys
from stages.imaging.frames import without_frame
from stages.imaging.pictures import Picture, resize_picture
from stages.scene.cameras import Cameras, single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.learnt_views import learnt_names
from stages.scene.scene import Scene

CERTAIN = 6.0
"""The standard score at which half of the watermark shows: by Student's distribution one look in 1.6 million at
pictures without the grain comes so far. A picture gets up to two (`GrainReader.score`)."""

FOUND_SHARE = 0.75
"""Of the watermark that a half of it explains: what a picture at `CERTAIN` shows."""


class GrainReader:
    """Finds the camera of a picture, and how far the picture follows the coins.

    `gaussians` and `method` are the container without grain, `throws` the coins of its Gaussians, then the decoys,
    `cameras` a rig that looks at it, at least one: what a picture shows must be seen by some of them. Gaussians, throws
    and the method's networks are on one device.
    """

    def __init__(self, gaussians: Gaussians, method: Method, cameras: Cameras, throws: Float[Tensor, "N K"]):
        self.gaussians, self.method, self.throws = gaussians, method, throws
        self.landmarks = landmarks(gaussians, method, cameras)
        self.intrinsics = np.median(cameras.intrinsics, axis=0)
        self.sides = sorted((cameras.width, cameras.height))

    def score(self, picture: Picture) -> float:
        """The better standard score of up to two looks; 0 where none finds a camera: nothing then speaks for the grain.

        One as large as the rig's pictures is looked at as it is. Of others, rows and columns of one colour at the edges
        go first: they are a screenshot's, or a letterbox's; without those that are the scene's own background its
        camera is found as well. What is then larger than the rig's is reduced to their size, and gets one look. What is
        smaller may have been cut out or reduced, and gets two, as it is and enlarged: which of them is right no camera
        tells, for one is found at the wrong size, too. So chance comes to `CERTAIN` in one of 1.6 million pictures, and
        in one of 815,000 of those that are smaller. A mirrored picture is turned round before (`recognised`).

        A picture without colour, or of one colour, has none of the grain, and scores 0.
        """
        if is_colorless(picture):
            return 0.0
        scores = [score for size in self._sizes(picture) if (score := self._score_at(size)) is not None]
        return max(scores, default=0.0)

    def _score_at(self, picture: Picture) -> float | None:
        """By the camera that is found at this size, of the picture or of its mirror image; None without one."""
        found = recognised(picture, self.landmarks, self.intrinsics)
        if found is None:
            return None
        camera = single_cameras(aligned(found.picture, self.gaussians, self.method, found.camera))[0]
        return standard_score(found.picture, self.gaussians, self.method, camera, self.throws)

    def _sizes(self, picture: Picture) -> Iterator[Picture]:
        inner = picture if sorted(picture.shape[:2]) == self.sides else without_frame(picture)
        if inner.size == 0:
            return
        height, width = inner.shape[:2]
        factor = self.sides[-1] / max(width, height)
        if factor >= 1:
            yield inner
        if factor != 1:
            yield resize_picture(inner, max(1, round(width * factor)), max(1, round(height * factor)))

    def certainty(self, picture: Picture) -> float:
        """From 0 to 1, by which the owner's reading lets the watermark show: a half at a score of `CERTAIN`."""
        return 0.5 * (1 + math.tanh((self.score(picture) - CERTAIN) / 2))


def is_colorless(picture: Picture) -> bool:
    """Whether red, green and blue are the same in every pixel: then it tells nothing, for the grain lies in colour."""
    return bool((picture == picture[..., :1]).all())


def owners_reader(
    before: Artifact, scene: Scene, key: Artifact | None, seed: int, device: torch.device | str = "cpu"
) -> GrainReader:
    """Of the container from before the grain, with the key, or else the seed, that `add_grain` had, on a device.

    Raises `UserError` for a scene without training views.
    """
    gaussians = read_gaussians(before, device)
    throws = with_decoys(len(gaussians), key_generator(key, seed)).to(device)
    return GrainReader(gaussians, read_method(before, device=device), scene.cameras.select(learnt_names(scene)), throws)
