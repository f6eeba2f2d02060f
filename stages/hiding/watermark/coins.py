"""Coins: how each Gaussian is changed by a grain, one way or the other, and whether a picture follows them."""

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
"""Further throws, which nothing follows: what chance comes to. They are as secret as the coins. Who knew them could add
all of them to a picture, so that the grain drowns in what chance then comes to, or take them from a picture without the
grain, which then seems to have it: on the fox 1.5 levels, as much as the grain itself, take a score of 48 to 6, and one
of -0.5 to 7.8; of another key's decoys, to 28 and -1.2."""

EDGES = (1.5, 4.0, 12.0)
"""Pixels: Gaussians of these standard deviations part a picture's details into bands, the finest first, and what is
coarser than all of them is not compared. JPEG leaves next to nothing of the finest in colours, and other pictures
differ most in the coarsest: each band has weights of its own. At 200 pixels, after JPEG of quality 70 (4:2:0), the
finest alone found the grain in 18 of 30 renders (fox and bonsai, 3DGS and GS-Hider), all bands in 28, for up to a third
of what renders score as they are (25 to 39) and 0.05 seconds a picture; at 400 pixels 0.2."""

NEIGHBOURHOOD = 9
"""Sides in pixels over which a picture's own variance is taken: a quiet place tells more than a busy one."""

LEAST_VARIANCE = 1e-5
"""Added to it, of pictures in [0, 1]: eight times what rounding to bytes adds."""


def thrown(count: int, generator: np.random.Generator) -> Coins:
    """One for each of so many Gaussians; a grain's are the first that the generator of its key throws."""
    return generator.choice([-1.0, 1.0], size=count)


def with_decoys(count: int, generator: np.random.Generator) -> Float[Tensor, "N K"]:
    """The coins that `thrown` gives first, and after them `DECOYS` further throws, the same for every picture."""
    throws = np.stack([thrown(count, generator) for _ in range(1 + DECOYS)], axis=1)
    return torch.from_numpy(throws).float().contiguous()


def standard_score(
    picture: Picture, gaussians: Gaussians, method: Method, camera: Camera, throws: Float[Tensor, "N K"]
) -> float:
    """How much better the picture follows the first of the throws than the others, in standard deviations of these.

    What is left of the picture's colour after the render without grain is correlated with the coins as the camera sees
    them, band by band. Of a picture that knows nothing of the coins, whatever it shows and wherever the camera stands,
    the score is that of one more decoy: its mean is 0 and its standard deviation 1, by Student's distribution with
    `DECOYS` - 1 degrees of freedom. So the rate of false alarms follows from the coins' randomness, and not from
    pictures that were tried. That holds where the Gaussians, those without grain, were fixed before the coins fell. Who
    takes coins that he throws today from the published ones, and calls the rest his own from before, finds them in
    renders of the published ones and in photos of the scene. 0 where nothing is left to compare.
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
    """The picture less the render, whose brightness and contrast are fitted, in the grain's colour."""
    render = method.render(gaussians, camera, wanted=[COVER]).pictures[COVER].cpu().double().numpy()
    values = picture / 255
    told = np.stack([render.ravel(), np.ones(render.size)], axis=1)
    gain, offset = np.linalg.lstsq(told, values.ravel(), rcond=None)[0]
    return np.asarray((values - gain * render - offset) @ COLORS[GRAIN].double().numpy())


@torch.no_grad()
def _seen(gaussians: Gaussians, camera: Camera, throws: Float[Tensor, "N K"]) -> Float64[np.ndarray, "H W K"]:
    """The throws, blended as colours are."""
    return splat(gaussians, throws, camera).feature_map.cpu().double().numpy()


def _bands(values: Float64[np.ndarray, "H W *K"]) -> Iterator[Float64[np.ndarray, "H W *K"]]:
    """The details between one of `EDGES` and the next."""
    for edge in EDGES:
        coarser = cv2.GaussianBlur(values, (0, 0), edge)
        yield values - coarser
        values = coarser
