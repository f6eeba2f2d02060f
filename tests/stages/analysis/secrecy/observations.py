"""Views without a rasterizer: a feature map in which cover and message lie along known directions."""

from __future__ import annotations

import torch
from torch import Tensor

from stages.analysis.secrecy.observing import Observed
from stages.hiding.rendering import COVER, Rendering
from stages.scene.cameras import Camera

HEIGHT, WIDTH = 24, 20


def smooth(generator: torch.Generator, channels: int = 3) -> Tensor:
    """A picture of blurred noise in [0, 1], so that neighbours resemble each other."""
    noise = torch.rand(1, channels, HEIGHT // 4, WIDTH // 4, generator=generator)
    return torch.nn.functional.interpolate(noise, (HEIGHT, WIDTH), mode="bilinear")[0].permute(1, 2, 0)


def camera() -> Camera:
    intrinsics = torch.tensor([[20.0, 0, WIDTH / 2], [0, 20.0, HEIGHT / 2], [0, 0, 1]])
    return Camera(torch.eye(4), intrinsics, torch.zeros(3), WIDTH, HEIGHT)


def views(mixture: Tensor, count: int = 3, seed: int = 0) -> list[Observed]:
    """`count` views whose features are [cover, message] @ mixture: `mixture` is [6, M]."""
    generator = torch.Generator().manual_seed(seed)
    observed = []
    for view in range(count):
        cover, message = smooth(generator), smooth(generator)
        feature_map = torch.cat([cover, message], dim=-1) @ mixture
        alphas = torch.ones(HEIGHT, WIDTH)
        rendering = Rendering({COVER: cover}, feature_map, alphas, torch.empty(0, dtype=torch.int32), torch.empty(0, 2))
        observed.append(Observed(f"{view}.png", camera(), rendering, message[None], torch.ones(1, HEIGHT, WIDTH)))
    return observed
