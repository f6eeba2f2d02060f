"""Small scenes for the rasterizer's tests, and which of their pixels are at a threshold."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from opencl.contract import RasterOutput, RasterSettings
from opencl.rasterizer import rasterize
from opencl.reference import rasterize_reference
from tests.opencl.discontinuities import find_discontinuities

DEFAULT = RasterSettings()
FAINT = RasterSettings(alpha_minimum=1e-7)
"""Gaussians with edges so faint that it hardly matters on which side of the threshold a pixel is. Tests share these
settings, as any others would be compiled anew: seconds for each schedule and precision."""


@dataclass(frozen=True)
class Scene:
    """The rasterizer's arguments."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    features: Tensor
    world_to_camera: Tensor
    intrinsics: Tensor
    width: int
    height: int
    background: Tensor
    settings: RasterSettings = DEFAULT

    @property
    def gaussians(self) -> tuple[Tensor, ...]:
        return self.means, self.quats, self.scales, self.opacities, self.features

    @property
    def camera(self) -> tuple[Tensor, Tensor, int, int]:
        return self.world_to_camera, self.intrinsics, self.width, self.height

    def to(self, dtype: torch.dtype) -> Scene:
        tensors = {name: value.to(dtype) for name, value in vars(self).items() if isinstance(value, Tensor)}
        return replace(self, **tensors)

    def only(self, chosen: Tensor) -> Scene:
        """The same scene with only some of its Gaussians."""
        means, quats, scales, opacities, features = (tensor[chosen] for tensor in self.gaussians)
        return replace(self, means=means, quats=quats, scales=scales, opacities=opacities, features=features)

    def draw(self) -> RasterOutput:
        return rasterize(*self.gaussians, *self.camera, self.background, self.settings)

    def draw_reference(self) -> RasterOutput:
        return rasterize_reference(*self.gaussians, *self.camera, self.background, self.settings)


def make_scene(
    count: int = 60,
    feature_dim: int = 3,
    width: int = 37,
    height: int = 29,
    seed: int = 0,
    size: float = 0.25,
    opacity: tuple[float, float] = (0.05, 1.0),
    dtype: torch.dtype = torch.float64,
    settings: RasterSettings = DEFAULT,
) -> Scene:
    """Random Gaussians in a box in front of a rotated camera with an off-centre principal point."""
    random = torch.Generator().manual_seed(seed)

    def uniform(*shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=random, dtype=torch.float64)

    turn = torch.linalg.qr(torch.eye(3, dtype=torch.float64) + 0.2 * uniform(3, 3)).Q
    turn = turn * torch.sign(torch.diagonal(turn))
    world_to_camera = torch.eye(4, dtype=torch.float64)
    world_to_camera[:3, :3] = turn
    world_to_camera[:3, 3] = torch.tensor([0.1, -0.2, 0.3], dtype=torch.float64)
    in_camera = uniform(count, 3, low=-1.2, high=1.2) + torch.tensor([0.0, 0.0, 3.0], dtype=torch.float64)
    intrinsics = torch.tensor(
        [[0.9 * width, 0, 0.5 * width + 1.3], [0, 0.95 * width, 0.5 * height - 0.7], [0, 0, 1]], dtype=torch.float64
    )
    return Scene(
        means=(in_camera - world_to_camera[:3, 3]) @ turn,
        quats=torch.randn(count, 4, generator=random, dtype=torch.float64),
        scales=size * torch.exp(0.6 * torch.randn(count, 3, generator=random, dtype=torch.float64)),
        opacities=uniform(count, low=opacity[0], high=opacity[1]),
        features=uniform(count, feature_dim, low=-1.0),
        world_to_camera=world_to_camera,
        intrinsics=intrinsics,
        width=width,
        height=height,
        background=uniform(feature_dim, low=-1.0),
        settings=settings,
    ).to(dtype)


def one_gaussian(
    centre: tuple[float, float, float] = (0.0, 0.0, 2.0),
    scales: tuple[float, float, float] = (0.2, 0.2, 0.2),
    opacity: float = 0.5,
    width: int = 20,
    height: int = 18,
    dtype: torch.dtype = torch.float64,
    settings: RasterSettings = DEFAULT,
) -> Scene:
    """A single Gaussian with feature 1, in the frame of a camera with focal length 20, on a background of 0."""
    return Scene(
        means=torch.tensor([centre], dtype=dtype),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=dtype),
        scales=torch.tensor([scales], dtype=dtype),
        opacities=torch.tensor([opacity], dtype=dtype),
        features=torch.ones(1, 1, dtype=dtype),
        world_to_camera=torch.eye(4, dtype=dtype),
        intrinsics=torch.tensor([[20.0, 0, width / 2], [0, 20.0, height / 2], [0, 0, 1]], dtype=dtype),
        width=width,
        height=height,
        background=torch.zeros(1, dtype=dtype),
        settings=settings,
    )


def near_a_threshold(scene: Scene, margin: float = 1e-3) -> Tensor:
    """[height, width]: pixels where alpha or transmittance comes within a relative `margin` of a threshold.

    There, two exact rasterizers may differ by a whole Gaussian, so comparisons exclude these pixels.
    """
    return find_discontinuities(scene, margin).influence > 0


def gradients(output: RasterOutput, leaves: tuple[Tensor, ...], seed: int = 0) -> tuple[Tensor, ...]:
    """Gradients of a random linear function of features and alphas, for the leaves and for `means2d`."""
    random = torch.Generator().manual_seed(seed)
    weights = torch.randn(output.features.shape, generator=random, dtype=torch.float64).to(output.features.dtype)
    alpha_weights = torch.randn(output.alphas.shape, generator=random, dtype=torch.float64).to(output.alphas.dtype)
    loss = (output.features * weights).sum() + (output.alphas * alpha_weights).sum()
    return torch.autograd.grad(loss, [*leaves, output.means2d])
