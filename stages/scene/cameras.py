"""A rig of pinhole cameras that share one picture size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from pipeline.errors import UserError


@dataclass(frozen=True)
class Cameras:
    """V pinhole cameras, in the world frame of their structure from motion.

    `world_to_camera` maps homogeneous world points to camera space: x right, y down, looking along +z (COLMAP, OpenCV).
    `intrinsics` are in pixels of a `width` x `height` picture whose pixel centres are at +0.5. V = 0 is allowed. Raises
    `UserError` if shapes disagree, or a pose or an intrinsic matrix is not finite.
    """

    names: tuple[str, ...]
    world_to_camera: Float64[np.ndarray, "V 4 4"]
    intrinsics: Float64[np.ndarray, "V 3 3"]
    width: int
    height: int

    def __post_init__(self) -> None:
        views = len(self.names)
        for field, shape in (("world_to_camera", (views, 4, 4)), ("intrinsics", (views, 3, 3))):
            found = getattr(self, field)
            if found.shape != shape:
                raise UserError(f"cameras have a wrong {field}", found=str(found.shape), expected=str(shape))
            broken = [name for name, matrix in zip(self.names, found, strict=True) if not np.isfinite(matrix).all()]
            if broken:
                raise UserError(
                    f"a camera's {field} is not finite",
                    where=", ".join(broken[:5]),
                    found="NaN or infinity",
                    expected="finite numbers",
                    remedy="leave those views out, or repair the poses that came with the photos",
                )

    def __len__(self) -> int:
        return len(self.names)

    def centres(self) -> Float64[np.ndarray, "V 3"]:
        """Camera centres in world coordinates: -Rᵀt."""
        rotation, translation = self.world_to_camera[:, :3, :3], self.world_to_camera[:, :3, 3]
        return -np.einsum("vij,vi->vj", rotation, translation)

    def select(self, names: Sequence[str]) -> Cameras:
        """The cameras with these names, in this order. Raises `KeyError` for an unknown name."""
        index = {name: position for position, name in enumerate(self.names)}
        rows = [index[name] for name in names]
        return replace(
            self, names=tuple(names), world_to_camera=self.world_to_camera[rows], intrinsics=self.intrinsics[rows]
        )

    def resized(self, width: int, height: int) -> Cameras:
        """The same cameras with pictures of another size, in pixels; what they see stays the same."""
        scaling = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, intrinsics=scaling @ self.intrinsics, width=width, height=height)


ROUNDING = 1e-12
"""Cameras this close, relative to their coordinates, count as coincident."""


def rig_extent(cameras: Cameras) -> float:
    """3DGS's `spatial_lr_scale`: 1.1 times the largest distance of a camera from the cameras' mean, in world units.

    Position learning rates and density control are relative to it. 1.0 for fewer than two cameras, or if all coincide.
    (3DGS uses the training cameras only. Here all of the scene's cameras count, since the poses of test views are
    known, unlike their pictures: for fox, bonsai and kitchen the two differ by 0.4, 0.1 and 3 percent.)
    """
    if len(cameras) < 2:
        return 1.0
    centres = cameras.centres()
    farthest = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    return 1.1 * farthest if farthest > ROUNDING * np.abs(centres).max() else 1.0


@dataclass(frozen=True)
class Camera:
    """One camera for the rasterizer, as float32 tensors."""

    world_to_camera: Float[Tensor, "4 4"]
    intrinsics: Float[Tensor, "3 3"]
    centre: Float[Tensor, " 3"]
    width: int
    height: int


def single_cameras(cameras: Cameras) -> tuple[Camera, ...]:
    """The cameras one by one, in the rig's order."""
    centres = cameras.centres()
    return tuple(
        Camera(
            torch.as_tensor(cameras.world_to_camera[view], dtype=torch.float32),
            torch.as_tensor(cameras.intrinsics[view], dtype=torch.float32),
            torch.as_tensor(centres[view], dtype=torch.float32),
            cameras.width,
            cameras.height,
        )
        for view in range(len(cameras))
    )


def depths_before(means: Float[Tensor, "N 3"], camera: Camera) -> Float[Tensor, " N"]:
    """How far points lie before the camera along its optical axis, in world units; negative behind it."""
    towards = camera.world_to_camera[2].to(means.device)
    return means @ towards[:3] + towards[3]


def pixel_directions(camera: Camera, device: torch.device | str = "cpu") -> Float[Tensor, "H W 3"]:
    """Unit vectors in world coordinates from the camera through each pixel's centre, computed on `device`."""
    across, down = (torch.arange(side, device=device) + 0.5 for side in (camera.width, camera.height))
    x, y = torch.meshgrid(across, down, indexing="xy")
    pixels = torch.stack([x, y, torch.ones_like(x)], dim=-1)
    local = pixels @ torch.linalg.inv(camera.intrinsics).T.to(device)
    return torch.nn.functional.normalize(local @ camera.world_to_camera[:3, :3].to(device), dim=-1)
