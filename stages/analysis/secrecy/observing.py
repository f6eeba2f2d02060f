"""Views as any holder of the container renders them, with the messages' pictures by which readings are judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.method import Method
from stages.hiding.rendering import COVER, Rendering
from stages.imaging.pictures import picture_to_tensor
from stages.scene.cameras import Camera, single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.message_views import MessageViews
from stages.scene.scene import Scene


@dataclass(frozen=True)
class Observed:
    """One view: `rendering` holds F_coup and the cover's picture, both from public parts only.

    `truths` are the pictures of the L messages, `coverage` the share of each pixel that they fill. Both are the
    owner's; an attacker has them only for the views that leaked.
    """

    view: str
    camera: Camera
    rendering: Rendering
    truths: Float[Tensor, "L H W 3"]
    coverage: Float[Tensor, "L H W"]

    @property
    def cover(self) -> Float[Tensor, "H W 3"]:
        """The cover as rendered from the container, clamped to [0, 1]."""
        return self.rendering.pictures[COVER].clamp(0, 1)

    def with_feature_map(self, feature_map: Float[Tensor, "H W M"]) -> Observed:
        """A copy with another feature map."""
        return replace(self, rendering=replace(self.rendering, feature_map=feature_map))

    def to(self, device: torch.device) -> Observed:
        """A copy with its tensors on a device, except for the camera's."""
        rendering = replace(
            self.rendering,
            pictures={name: picture.to(device) for name, picture in self.rendering.pictures.items()},
            feature_map=self.rendering.feature_map.to(device),
            alphas=self.rendering.alphas.to(device),
        )
        return replace(self, rendering=rendering, truths=self.truths.to(device), coverage=self.coverage.to(device))

    def crop(self, row: int, column: int, height: int, width: int) -> Observed:
        """The part of at most `height` x `width` pixels at (`row`, `column`), with the principal point shifted."""
        rows, columns = slice(row, row + height), slice(column, column + width)
        feature_map = self.rendering.feature_map[rows, columns]
        intrinsics = self.camera.intrinsics.clone()
        intrinsics[0, 2] -= column
        intrinsics[1, 2] -= row
        rendering = replace(
            self.rendering,
            pictures={name: picture[rows, columns] for name, picture in self.rendering.pictures.items()},
            feature_map=feature_map,
            alphas=self.rendering.alphas[rows, columns],
        )
        height, width = feature_map.shape[:2]
        camera = replace(self.camera, intrinsics=intrinsics, width=width, height=height)
        return Observed(self.view, camera, rendering, self.truths[:, rows, columns], self.coverage[:, rows, columns])


@torch.no_grad()
def observe(
    gaussians: Gaussians,
    method: Method,
    scene: Scene,
    messages: Mapping[str, MessageViews],
    views: Sequence[str],
) -> list[Observed]:
    """The named views, in this order; `messages` must be in the order of the message decoder's channels."""
    cameras = single_cameras(scene.cameras.select(views))
    observed = []
    for view, row, camera in zip(views, scene.rows(views), cameras, strict=True):
        observed.append(
            Observed(
                view,
                camera,
                method.render(gaussians, camera, wanted=(COVER,)),
                torch.stack([picture_to_tensor(message.pictures[row]) for message in messages.values()]),
                torch.stack([torch.from_numpy(message.coverage[row]) for message in messages.values()]),
            )
        )
    return observed
