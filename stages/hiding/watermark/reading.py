"""Detecting grain in a picture; the owner has the container from before the grain and knows the coins."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

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
from stages.imaging.borders import without_borders
from stages.imaging.pictures import Picture, resize_picture
from stages.scene.cameras import Cameras, single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.learnt_views import learnt_names
from stages.scene.scene import Scene

CERTAIN = 6.0
"""The standard score at which half of the watermark is shown. By Student's distribution, a picture without the grain
gets there by chance in one test of 1.6 million. Each picture has up to two tests (`GrainReader.score`)."""

FOUND_SHARE = 0.75
"""Share of the watermark's energy that a picture at `CERTAIN`, which shows half of the watermark, explains."""


class GrainReader:
    """Finds a picture's camera, and how well the picture follows the coins.

    `gaussians` and `method` are the container without grain; `throws` holds the Gaussians' coins, then the decoys;
    `cameras` is a rig of at least one camera that looks at it: some of them must see what a picture shows. Gaussians,
    throws and the method's networks must be on the same device. The landmarks take up to 144 renders, after each of
    which `after_each` is called.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        method: Method,
        cameras: Cameras,
        throws: Float[Tensor, "N K"],
        after_each: Callable[[], None] = lambda: None,
    ):
        self.gaussians, self.method, self.throws = gaussians, method, throws
        self.landmarks = landmarks(gaussians, method, cameras, after_each)
        self.intrinsics = np.median(cameras.intrinsics, axis=0)
        self.sides = sorted((cameras.width, cameras.height))

    def score(self, picture: Picture) -> float:
        """The best standard score of up to two tests; 0, which is no evidence of the grain, if no camera is found.

        A picture of the rig's size is tested as it is. Otherwise, rows and columns of a single colour at the edges are
        removed first: they come from a screenshot or a letterbox; if they were the scene's own background, the camera
        is found without them, too. If the rest is larger than the rig's pictures, it is reduced to their size and gets
        one test. If it is smaller, it may have been cropped or reduced, and gets two tests: as it is and enlarged.
        Finding a camera does not tell which of these is right, since one is found at the wrong size, too. So one in 1.6
        million pictures reaches `CERTAIN` by chance, and one in 815,000 smaller pictures. A mirrored picture is
        mirrored back first (`recognised`).

        A picture without colour, or of a single colour, cannot contain the grain and scores 0.
        """
        if is_colorless(picture):
            return 0.0
        scores = [score for size in self._sizes(picture) if (score := self._score_at(size)) is not None]
        return max(scores, default=0.0)

    def _score_at(self, picture: Picture) -> float | None:
        """The score with the camera found at this size, for the picture or its mirror image; None without one."""
        found = recognised(picture, self.landmarks, self.intrinsics)
        if found is None:
            return None
        camera = single_cameras(aligned(found.picture, self.gaussians, self.method, found.camera))[0]
        return standard_score(found.picture, self.gaussians, self.method, camera, self.throws)

    def _sizes(self, picture: Picture) -> Iterator[Picture]:
        """Yield the picture at each size to be tested; nothing if all of it is a frame."""
        inner = picture if sorted(picture.shape[:2]) == self.sides else without_borders(picture)
        if inner.size == 0:
            return
        height, width = inner.shape[:2]
        factor = self.sides[-1] / max(width, height)
        if factor >= 1:
            yield inner
        if factor != 1:
            yield resize_picture(inner, max(1, round(width * factor)), max(1, round(height * factor)))

    def certainty(self, picture: Picture) -> float:
        """The weight from 0 to 1 with which the owner's reading shows the watermark: 0.5 at a score of `CERTAIN`."""
        return 0.5 * (1 + math.tanh((self.score(picture) - CERTAIN) / 2))


def is_colorless(picture: Picture) -> bool:
    """Whether red, green and blue are equal in every pixel: such a picture says nothing, since grain is in colour."""
    return bool((picture == picture[..., :1]).all())


def owners_reader(
    before: Artifact,
    scene: Scene,
    key: Artifact | None,
    seed: int,
    device: torch.device | str = "cpu",
    after_each: Callable[[], None] = lambda: None,
) -> GrainReader:
    """A reader on a device, from the container `before` the grain and the key, or else the seed, given to `add_grain`.

    Raises `UserError` for a scene without training views.
    """
    gaussians, cameras = read_gaussians(before, device), scene.cameras.select(learnt_names(scene))
    throws = with_decoys(len(gaussians), key_generator(key, seed)).to(device)
    return GrainReader(gaussians, read_method(before, device=device), cameras, throws, after_each)
