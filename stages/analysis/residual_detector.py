"""A small learned detector: a convolutional network on the residuals of fixed high-pass filters.

As in image steganalysis (SRM's residuals, the networks YeNet and SRNet), it sees noise rather than content: residuals
are truncated, and their statistics are pooled over the whole picture. Every channel passes through the same network,
whose outputs are pooled over channels, so that channel order does not matter: channels of different containers do not
correspond. The same architecture thus serves pictures and feature maps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, islice
from operator import attrgetter

import numpy as np
import torch
from jaxtyping import Float, Float32, Shaped
from torch import Tensor

from stages.analysis import stored_views
from stages.training.adam import Adam

TRUNCATION = 3.0
"""In grey levels: a larger residual is an edge, whose height is irrelevant."""

CONTRAST = 64.0
"""The standard deviation to which each channel of a feature map is scaled, similar to a picture's in grey levels."""

CUT_AT_ONCE = 2400
"""The number of pairs of crops that are in memory at once: 0.6 GB of 16 channels, 64 pixels a side.

Reading and decoding a large view takes longer than a training step, so each is read once for all of these crops.
"""

FILTERS = torch.tensor(
    [
        [[0, 0, 0], [0, -1, 1], [0, 0, 0]],
        [[0, 0, 0], [0, -1, 0], [0, 1, 0]],
        [[0, 0, 0], [0.5, -1, 0.5], [0, 0, 0]],
        [[0, 0.5, 0], [0, -1, 0], [0, 0.5, 0]],
        [[-0.25, 0.5, -0.25], [0.5, -1, 0.5], [-0.25, 0.5, -0.25]],
    ]
)
"""First- and second-order differences, each horizontal and vertical, and a second-order difference along both axes."""


class ResidualDetector(torch.nn.Module):
    """Maps `[B, C, H, W]` in grey levels, with any number of channels, to B logits: the larger, the likelier hidden."""

    def __init__(self, width: int = 16):
        super().__init__()
        self.features = torch.nn.Sequential(
            torch.nn.Conv2d(len(FILTERS), width, 3),
            torch.nn.ReLU(),
            torch.nn.AvgPool2d(2),
            torch.nn.Conv2d(width, 2 * width, 3),
            torch.nn.ReLU(),
            torch.nn.AvgPool2d(2),
            torch.nn.Conv2d(2 * width, 2 * width, 3),
            torch.nn.ReLU(),
            torch.nn.AdaptiveAvgPool2d(1),
            torch.nn.Flatten(),
        )
        self.verdict = torch.nn.Linear(4 * width, 1)

    def forward(self, values: Float[Tensor, "B C H W"]) -> Float[Tensor, " B"]:
        """The logits, from the mean and the maximum over channels of the network's outputs."""
        batch, channels = values.shape[:2]
        filters = FILTERS.to(values.device).unsqueeze(1)
        residuals = torch.nn.functional.conv2d(values.flatten(0, 1).unsqueeze(1), filters)
        found = self.features(residuals.clamp(-TRUNCATION, TRUNCATION) / TRUNCATION).unflatten(0, (batch, channels))
        pooled = torch.cat([found.mean(dim=1), found.amax(dim=1)], dim=1)
        return self.verdict(pooled).squeeze(1)


@dataclass(frozen=True)
class Views:
    """V pictures or feature maps of one container, and the factor for each channel of each of them."""

    values: stored_views.Views  # [V, H, W, C], bytes or float16
    gains: Float32[np.ndarray, "V C"]

    def tensor(self, view: int) -> Float[Tensor, "C H W"]:
        """A scaled view."""
        return self.scaled(view, self.values[view])

    def scaled(self, view: int, crop: Shaped[np.ndarray, "H W C"]) -> Float[Tensor, "C H W"]:
        """A crop of a view, scaled as the view is."""
        values = crop.astype(np.float32) * self.gains[view]
        return torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1)))


def views_of(values: stored_views.Views) -> Views:
    """Pictures (uint8) unscaled, in grey levels; feature maps with each channel scaled to the deviation `CONTRAST`.

    Views on disk are read one at a time, here and at every later access.
    """
    if values.dtype == np.uint8:
        return Views(values, np.ones((len(values), values.shape[-1]), np.float32))
    deviations = np.stack([view.astype(np.float32).std(axis=(0, 1)) for view in values])
    return Views(values, CONTRAST / np.maximum(deviations, 1e-6))


def train_detector(
    scenes: Sequence[tuple[Views, Views]],
    seed: int,
    iterations: int = 300,
    batch: int = 8,
    size: int = 64,
    after_each: Callable[[int], None] = lambda iteration: None,
    device: torch.device | str = "cpu",
) -> ResidualDetector:
    """Train a detector on pairs of hidden and clean views of scenes, both from the same cameras.

    Every step sees `batch` random crops of `size` pixels a side, each from the hidden and the clean view alike, so
    that content gives no hint. `seed` determines the weights and the crops. The detector is trained, and stays, on
    `device`; views are on the CPU. Raises `ValueError` if there are no scenes.
    """
    if not scenes:
        raise ValueError("a detector needs scenes to learn from")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        detector = ResidualDetector().to(device)
    pairs = _pairs(scenes, size, iterations * batch, np.random.default_rng(seed))
    optimizer = Adam(detector.parameters(), lr=1e-3)
    for iteration in range(1, iterations + 1):
        both = list(islice(pairs, batch))
        hidden, clean = (_logits(detector, [pair[side] for pair in both]) for side in (0, 1))
        loss = torch.nn.functional.softplus(-hidden).mean() + torch.nn.functional.softplus(clean).mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        after_each(iteration)
    return detector.eval()


@torch.no_grad()
def detector_scores(detector: ResidualDetector, views: Views) -> list[float]:
    """The logit of every uncropped view."""
    device = detector.verdict.weight.device
    return [float(detector(views.tensor(view).to(device).unsqueeze(0))) for view in range(len(views.values))]


@dataclass(frozen=True)
class Place:
    """Where a crop is cut from a view of a scene, and the axes of `[C, H, W]` along which it is flipped."""

    scene: int
    view: int
    top: int
    left: int
    flipped: tuple[int, ...]


def _pairs(
    scenes: Sequence[tuple[Views, Views]], size: int, count: int, generator: np.random.Generator
) -> Iterator[tuple[Tensor, Tensor]]:
    """`count` times the same random crop of the same view from both classes, `CUT_AT_ONCE` of them at once."""
    for first in range(0, count, CUT_AT_ONCE):
        places = [_place(scenes, size, generator) for _ in range(min(CUT_AT_ONCE, count - first))]
        crops = [_crops([scene[side] for scene in scenes], places, size) for side in (0, 1)]
        for place, *both in zip(places, *crops, strict=True):
            hidden, clean = (
                views.scaled(place.view, crop).flip(place.flipped)
                for views, crop in zip(scenes[place.scene], both, strict=True)
            )
            yield hidden, clean


def _place(scenes: Sequence[tuple[Views, Views]], size: int, generator: np.random.Generator) -> Place:
    """A random place; a side shorter than `size` is kept whole."""
    scene = int(generator.integers(len(scenes)))
    count, height, width, _ = scenes[scene][0].values.shape
    view = int(generator.integers(count))
    top, left = (int(generator.integers(max(1, side - size + 1))) for side in (height, width))
    return Place(scene, view, top, left, tuple(axis for axis in (1, 2) if generator.random() < 0.5))


def _crops(scenes: Sequence[Views], places: Sequence[Place], size: int) -> list[Shaped[np.ndarray, "H W C"]]:
    """The crop at each place, not scaled. Each view is read once, and only one is in memory at a time."""
    found = {}
    view_of = attrgetter("scene", "view")
    for (scene, view), own in groupby(sorted(places, key=view_of), view_of):
        values = scenes[scene].values[view]
        for place in own:
            found[place] = values[place.top : place.top + size, place.left : place.left + size].copy()
    return [found[place] for place in places]


def _logits(detector: ResidualDetector, crops: Sequence[Tensor]) -> Tensor:
    """The logits of all crops, batched by shape, since scenes may differ in size and channels; order is not kept."""
    by_shape: dict[torch.Size, list[Tensor]] = {}
    for crop in crops:
        by_shape.setdefault(crop.shape, []).append(crop)
    device = detector.verdict.weight.device
    return torch.cat([detector(torch.stack(group).to(device)) for group in by_shape.values()])
