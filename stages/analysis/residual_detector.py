"""A small learned detector: fixed high-pass filters, and a convolutional network on what they leave of a picture.

As in steganalysis of photos (SRM's residuals, YeNet's and SRNet's networks) it sees noise and not content: residuals
are truncated, and their statistics pooled over the whole picture. Every channel goes through the same network, and what
it finds is pooled over the channels, so that their order does not matter: channels of different containers do not
correspond. The same network thus serves pictures and feature maps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from stages.analysis import stored_views
from stages.training.adam import Adam

TRUNCATION = 3.0
"""In grey levels: what is larger is an edge, of which nothing is to be learnt but that it is one."""

CONTRAST = 64.0
"""Of a feature map's channels, the standard deviation that all are brought to: like a picture's in grey levels."""

FILTERS = torch.tensor(
    [
        [[0, 0, 0], [0, -1, 1], [0, 0, 0]],
        [[0, 0, 0], [0, -1, 0], [0, 1, 0]],
        [[0, 0, 0], [0.5, -1, 0.5], [0, 0, 0]],
        [[0, 0.5, 0], [0, -1, 0], [0, 0.5, 0]],
        [[-0.25, 0.5, -0.25], [0.5, -1, 0.5], [-0.25, 0.5, -0.25]],
    ]
)
"""Differences of the first and second order, both ways, and of the second order both ways at once."""


class ResidualDetector(torch.nn.Module):
    """From `[B, C, H, W]`, values in grey levels and any number of channels, to a logit each: larger where it hides."""

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
        """Mean and maximum over the channels of what the network finds in each."""
        batch, channels = values.shape[:2]
        filters = FILTERS.to(values.device).unsqueeze(1)
        residuals = torch.nn.functional.conv2d(values.flatten(0, 1).unsqueeze(1), filters)
        found = self.features(residuals.clamp(-TRUNCATION, TRUNCATION) / TRUNCATION).unflatten(0, (batch, channels))
        pooled = torch.cat([found.mean(dim=1), found.amax(dim=1)], dim=1)
        return self.verdict(pooled).squeeze(1)


@dataclass(frozen=True)
class Views:
    """V pictures or feature maps of one container, and by how much each channel of each is multiplied."""

    values: stored_views.Views  # [V, H, W, C], bytes or float16
    gains: Float32[np.ndarray, "V C"]

    def tensor(self, view: int, top: int = 0, left: int = 0, size: int | None = None) -> Float[Tensor, "C H W"]:
        """A view, or a square part of it."""
        rows, columns = (slice(start, None if size is None else start + size) for start in (top, left))
        values = self.values[view][rows, columns].astype(np.float32) * self.gains[view]
        return torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1)))


def views_of(values: stored_views.Views) -> Views:
    """Pictures as they are, in grey levels; the channels of feature maps brought to one contrast.

    Views on the disk are read one at a time, here and whenever they are looked at.
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
    """A detector trained on hidden and clean views of scenes, each pair from the same cameras.

    Every step sees `batch` places of random views, of the hidden and of the clean one each, so that content is no hint.
    Weights and places come from the seed. It learns, and stays, on `device`; views are on the CPU. Raises `ValueError`
    without scenes.
    """
    if not scenes:
        raise ValueError("a detector needs scenes to learn from")
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        detector = ResidualDetector().to(device)
    generator = np.random.default_rng(seed)
    optimizer = Adam(detector.parameters(), lr=1e-3)
    for iteration in range(1, iterations + 1):
        both = [_places(scenes[int(generator.integers(len(scenes)))], size, generator) for _ in range(batch)]
        hidden, clean = (_logits(detector, [pair[side] for pair in both]) for side in (0, 1))
        loss = torch.nn.functional.softplus(-hidden).mean() + torch.nn.functional.softplus(clean).mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        after_each(iteration)
    return detector.eval()


@torch.no_grad()
def detector_scores(detector: ResidualDetector, views: Views) -> list[float]:
    """The logit of every view as a whole."""
    device = detector.verdict.weight.device
    return [float(detector(views.tensor(view).to(device).unsqueeze(0))) for view in range(len(views.values))]


def _places(scene: tuple[Views, Views], size: int, generator: np.random.Generator) -> tuple[Tensor, Tensor]:
    """The same place of the same view in both, turned over at random; the whole view where it is smaller."""
    count, height, width, _ = scene[0].values.shape
    view = int(generator.integers(count))
    top, left = (int(generator.integers(max(1, side - size + 1))) for side in (height, width))
    flipped = [axis for axis in (1, 2) if generator.random() < 0.5]
    hidden, clean = (views.tensor(view, top, left, size).flip(flipped) for views in scene)
    return hidden, clean


def _logits(detector: ResidualDetector, places: Sequence[Tensor]) -> Tensor:
    """Scenes may differ in size and channels: those of one shape go together."""
    by_shape: dict[torch.Size, list[Tensor]] = {}
    for place in places:
        by_shape.setdefault(place.shape, []).append(place)
    device = detector.verdict.weight.device
    return torch.cat([detector(torch.stack(group).to(device)) for group in by_shape.values()])
