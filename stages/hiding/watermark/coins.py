"""Coins: the random sign with which a grain changes each Gaussian, and whether a picture follows these signs."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from stages.hiding.method import Method
from stages.hiding.rendering import COVER, splat
from stages.hiding.watermark.colors import COLORS, GRAIN
from stages.imaging.pictures import Picture
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians

Coins = Float64[np.ndarray, " N"]
"""-1 or 1 for each Gaussian, in the order of the container's rows."""

DECOYS = 32
"""Number of further sets of random signs, which nothing was changed by: they show what scores arise by chance. They are
as secret as the coins. Someone who knew them could add all of them to a picture, so that the grain drowns in the scores
of the decoys, or subtract them from a picture without the grain, which then seems to have it: on the fox, 1.5 levels of
them, as much as the grain itself, turn a score of 48 into 6, and one of -0.5 into 7.8; another key's decoys turn these
into 28 and -1.2."""

EDGES = (1.5, 4.0, 12.0)
"""Standard deviations, in pixels, of Gaussian filters that split a picture's details into bands, the finest first;
what is coarser than all of them is not compared. JPEG leaves next to nothing of the finest band in colour, and
unrelated pictures differ most in the coarsest, so each band has weights of its own. At 200 pixels, after JPEG of
quality 70 (4:2:0), the finest band alone found the grain in 18 of 30 renders (fox and bonsai, 3DGS and GS-Hider),
and all bands in 28, for up to a third of the scores of uncompressed renders (25 to 39) and 0.05 seconds per picture;
0.2 at 400 pixels."""

NEIGHBOURHOOD = 9
"""Side, in pixels, of the window over which a picture's own variance is taken: quiet places tell more than busy
ones."""

LEAST_VARIANCE = 1e-5
"""Added to that variance, for pictures in [0, 1]: eight times the variance of rounding to bytes."""


def thrown(count: int, generator: np.random.Generator) -> Coins:
    """Draw a sign for each of `count` Gaussians; a grain uses the first draw of its key's generator."""
    return generator.choice([-1.0, 1.0], size=count)


def with_decoys(count: int, generator: np.random.Generator) -> Float[Tensor, "N K"]:
    """The signs that `thrown` draws first, followed by `DECOYS` further draws, which are the same for every picture."""
    throws = np.empty((count, 1 + DECOYS), np.float32)  # filled by columns: stacked, they would be held in double, too
    for column in range(1 + DECOYS):
        throws[:, column] = thrown(count, generator)
    return torch.from_numpy(throws)


def standard_score(
    picture: Picture, gaussians: Gaussians, method: Method, camera: Camera, throws: Float[Tensor, "N K"]
) -> float:
    """How much better the picture follows the first column of `throws` than the others, in their standard deviations.

    The residual of the picture's colour, after subtracting the render without grain, is correlated with the signs as
    the camera sees them, band by band. For a picture that is independent of the coins, whatever it shows and wherever
    the camera is, the score is distributed like that of one more decoy: with mean 0 and standard deviation 1, by
    Student's distribution with `DECOYS` - 1 degrees of freedom. So the rate of false positives follows from the
    randomness of the coins, and not from a test set of pictures. This holds only if the Gaussians without grain were
    fixed before the coins were drawn. Someone who draws coins today, subtracts their grain from the published
    Gaussians, and claims the result as his own earlier work, finds it in renders of the published Gaussians and in
    photos of the scene. 0 if there is nothing to compare.
    """
    left_bands = _bands(_left(picture, gaussians, method, camera))
    sums, squares = np.zeros(throws.shape[1]), np.zeros(throws.shape[1])
    for left, seen in zip(left_bands, _bands(_seen(gaussians, camera, throws)), strict=True):
        weights = 1 / (cv2.blur(left**2, (NEIGHBOURHOOD, NEIGHBOURHOOD)) + LEAST_VARIANCE)
        sums += np.einsum("hw,hwk->k", left * weights, seen)
        squares += np.einsum("hw,hwk->k", weights, seen**2)
    if not (squares > 0).all():
        return 0.0
    scores = sums / np.sqrt(squares)
    spread = scores[1:].std(ddof=1)
    return float((scores[0] - scores[1:].mean()) / (spread * np.sqrt(1 + 1 / DECOYS))) if spread > 0 else 0.0


@torch.no_grad()
def _left(picture: Picture, gaussians: Gaussians, method: Method, camera: Camera) -> Float64[np.ndarray, "H W"]:
    """The picture less the render, with fitted brightness and contrast, projected onto the grain's colour."""
    render = method.render(gaussians, camera, wanted=[COVER]).pictures[COVER].cpu().double().numpy()
    values = picture / 255
    told = np.stack([render.ravel(), np.ones(render.size)], axis=1)
    gain, offset = np.linalg.lstsq(told, values.ravel(), rcond=None)[0]
    return np.asarray((values - gain * render - offset) @ COLORS[GRAIN].double().numpy())


@torch.no_grad()
def _seen(gaussians: Gaussians, camera: Camera, throws: Float[Tensor, "N K"]) -> Float64[np.ndarray, "H W K"]:
    """The signs as the camera sees them: blended like colours."""
    return splat(gaussians, throws, camera).feature_map.cpu().double().numpy()


def _bands(values: Float64[np.ndarray, "H W *K"]) -> Iterator[Float64[np.ndarray, "H W *K"]]:
    """Yield the details between each of `EDGES` and the next."""
    for edge in EDGES:
        coarser = cv2.GaussianBlur(values, (0, 0), edge)
        yield values - coarser
        values = coarser
