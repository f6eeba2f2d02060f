"""Grain read off a picture by its owner, who has the container from before and knows how the coins fell."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
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
from stages.imaging.pictures import Picture, resize_picture
from stages.scene.cameras import Cameras, single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.scene import Scene

CERTAIN = 6.0
"""The standard score at which half of the watermark shows: by Student's distribution one picture in a million and a
half without the grain comes so far."""


FOUND_SHARE = 0.75
"""Of the watermark that a half of it explains: what a picture at `CERTAIN` shows."""


class GrainReader:
    """Finds the camera of a picture, and how far the picture follows the coins.

    `gaussians` and `method` are the container without grain, `throws` the coins of its Gaussians, then the decoys,
    `cameras` a rig that looks at it, at least one: what a picture shows must be seen by some of them.
    """

    def __init__(self, gaussians: Gaussians, method: Method, cameras: Cameras, throws: Float[Tensor, "N K"]):
        self.gaussians, self.method, self.throws = gaussians, method, throws
        self.landmarks = landmarks(gaussians, method, cameras)
        self.intrinsics = np.median(cameras.intrinsics, axis=0)
        self.longer_side = max(cameras.width, cameras.height)

    def score(self, picture: Picture) -> float:
        """The standard score of a picture; 0 where no camera is found, since nothing then speaks for the grain.

        A picture larger than the rig's is reduced to their size. A smaller one may have been cut out or reduced, and is
        looked at as it is, and then enlarged.
        """
        for size in self._sizes(picture):
            found = recognised(size, self.landmarks, self.intrinsics)
            if found is not None:
                camera = single_cameras(aligned(size, self.gaussians, self.method, found))[0]
                return standard_score(size, self.gaussians, self.method, camera, self.throws)
        return 0.0

    def _sizes(self, picture: Picture) -> Iterator[Picture]:
        height, width = picture.shape[:2]
        factor = self.longer_side / max(width, height)
        if factor >= 1:
            yield picture
        if factor != 1:
            yield resize_picture(picture, max(1, round(width * factor)), max(1, round(height * factor)))

    def certainty(self, picture: Picture) -> float:
        """From 0 to 1, by which the owner's reading lets the watermark show: a half at a score of `CERTAIN`."""
        return 0.5 * (1 + math.tanh((self.score(picture) - CERTAIN) / 2))


def owners_reader(before: Artifact, scene: Scene, key: Artifact | None, seed: int) -> GrainReader:
    """Of the container from before the grain, with the key, or else the seed, that `add_grain` had."""
    gaussians = read_gaussians(before)
    throws = with_decoys(len(gaussians), key_generator(key, seed))
    return GrainReader(gaussians, read_method(before), scene.cameras.select(scene.train_names), throws)
