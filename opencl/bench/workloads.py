"""Benchmark workloads: reproducible random boxes of Gaussians like those of a trained scene, and trained scenes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.bench.ring import ring_of_views
from opencl.bench.splats import read_splats
from opencl.bench.view import View


@dataclass(frozen=True)
class Inputs:
    """Inputs of the rasterizer: Gaussians, and the views that draw them."""

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    scales: Float[Tensor, "N 3"]
    opacities: Float[Tensor, " N"]
    features: Float[Tensor, "N M"]
    views: tuple[View, ...]

    @property
    def trained(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        return self.means, self.quats, self.scales, self.opacities, self.features

    def with_features(self, count: int) -> Inputs:
        """The same inputs with only the first `count` features."""
        return replace(self, features=self.features[:, :count].contiguous())


class Workload(Protocol):
    """A named recipe for inputs, small enough to be sent to another process, which then creates the inputs."""

    @property
    def name(self) -> str: ...

    def inputs(self) -> Inputs: ...


@dataclass(frozen=True)
class Box:
    """Random Gaussians before a camera of 60 degrees (horizontally), of log-normal size, mostly a few pixels."""

    name: str
    count: int
    width: int
    height: int
    feature_dim: int = 16

    def inputs(self, seed: int = 0) -> Inputs:
        """Fills slightly more than the view. The mean 3-sigma radius is about 5.5 pixels, with a heavy tail."""
        random = torch.Generator().manual_seed(seed)
        focal = self.width / (2 * 0.57735)
        sides = torch.tensor([self.width, self.height])
        depths = 2 + 4 * torch.rand(self.count, generator=random)
        offsets = (torch.rand(self.count, 2, generator=random) - 0.5) * 1.1 * sides / focal
        common, each_axis = (torch.randn(self.count, axes, generator=random) for axes in (1, 3))
        sizes = (0.55 * common + 0.45 * each_axis).exp()
        intrinsics = torch.tensor([[focal, 0, self.width / 2], [0, focal, self.height / 2], [0, 0, 1]])
        return Inputs(
            means=torch.cat([offsets * depths[:, None], depths[:, None]], dim=1),
            quats=torch.randn(self.count, 4, generator=random),
            scales=sizes * depths[:, None] / focal * 5.5 / 3 / 1.81,
            opacities=torch.sigmoid(2 * torch.randn(self.count, generator=random)),
            features=torch.rand(self.count, self.feature_dim, generator=random),
            views=(View(torch.eye(4), intrinsics, self.width, self.height),),
        )


@dataclass(frozen=True)
class TrainedScene:
    """The Gaussians of a file, with random features, seen from a ring of cameras."""

    path: Path
    views: int = 4
    width: int = 1216
    height: int = 800
    feature_dim: int = 16

    @property
    def name(self) -> str:
        return self.path.name

    def inputs(self, seed: int = 0) -> Inputs:
        """Read the file. Raises ValueError or OSError if it cannot be read."""
        splats = read_splats(self.path)
        random = torch.Generator().manual_seed(seed)
        return Inputs(
            *(splats.means, splats.quats, splats.scales, splats.opacities),
            features=torch.rand(len(splats.means), self.feature_dim, generator=random),
            views=ring_of_views(splats.means, self.views, self.width, self.height),
        )


BOXES = (
    Box("A", 50_000, 400, 304),
    Box("B", 200_000, 1216, 800),
    Box("training-features", 15_000, 192, 144),
    Box("training-colours", 15_000, 192, 144, 3),
    Box("large", 2_000_000, 1216, 800),
    Box("paper", 1_000_000, 1600, 1060),
    Box("paper-32", 1_000_000, 1600, 1060, 32),
)
DEFAULT_WORKLOADS = ("A", "B", "training-features", "training-colours")
"""The workloads that take a second or two. `large` tests memory; `paper`, the paper's indoor size, is for GPUs."""


def box_named(name: str) -> Box:
    """The box of this name, ignoring case. Raises ValueError, which lists the boxes, if there is none."""
    for box in BOXES:
        if box.name.lower() == name.lower():
            return box
    raise ValueError(f"--workload: found {name!r}, expected one of {', '.join(box.name for box in BOXES)}")
