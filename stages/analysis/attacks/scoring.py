"""Quality of an attacked container: of the cover, as anyone renders it, and of the messages, as the owner does."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import fmean

import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.attacks.catalogue import ONE_COLOUR
from stages.analysis.attacks.target import Target
from stages.analysis.fidelity import Perceptual, covered_psnrs, one_colour_psnr, picture_figures, where_seen
from stages.hiding.method import Method, ReadsRenders, move_networks
from stages.hiding.networks import PUBLIC_NETWORKS
from stages.hiding.rendering import COVER
from stages.imaging.metric_table import mean_of_known
from stages.imaging.pictures import picture_to_tensor
from stages.imaging.psnr import psnr
from stages.scene.cameras import single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.message_views import MessageViews
from stages.scene.scene import Scene

Figures = Mapping[tuple[str | None, str], float]
"""Means over views by (message, quantity); the message is None for the cover."""


class Scorer:
    """Measures attacked containers on the named `views` of the scene.

    `owner` is the method with the secret, which no attacker has. `opened` unseals the Gaussians of a sealed container
    before the owner reads the messages; the cover is rendered without it. Rendering runs on `device`; targets and all
    pictures are on the CPU.
    """

    def __init__(
        self,
        owner: Method,
        scene: Scene,
        messages: Mapping[str, MessageViews],
        views: Sequence[str],
        device: torch.device | str = "cpu",
        opened: Callable[[Gaussians], Gaussians] = lambda gaussians: gaussians,
    ):
        self.opened = opened
        self.owner, self.scene, self.messages, self.device = copy.deepcopy(owner), scene, messages, device
        move_networks(self.owner, device)
        self.views, self.rows = tuple(views), scene.rows(views)

    def cover_psnr(self, attacked: Target) -> float:
        """Mean PSNR of the cover, by which severities are calibrated. NaN if a view cannot be rendered."""
        pictures = self._pictures(attacked, (COVER,))
        return fmean([psnr(shown[COVER], self._truth(row)) for row, shown in zip(self.rows, pictures, strict=True)])

    def figures(self, attacked: Target, perceptual: Perceptual | None = None) -> Figures:
        """PSNR and SSIM of cover and messages, PSNR over the messages' covered pixels, and the cover's LPIPS if asked.

        Views that show nothing of a message do not count for it, as in `one_colour`. If a view of the cover cannot be
        rendered, the cover's figures are NaN: otherwise an attack that destroys some views would seem to spare it.
        """
        by_view: dict[tuple[str | None, str], list[float]] = {}
        for row, shown in zip(self.rows, self._pictures(attacked, (COVER, *self.messages)), strict=True):
            for quantity, value in picture_figures(shown[COVER], self._truth(row), perceptual or {}).items():
                by_view.setdefault((None, quantity), []).append(value)
            for name, message in self.messages.items():
                truth = picture_to_tensor(message.pictures[row])
                covered = covered_psnrs(shown[name], truth, torch.from_numpy(message.coverage[row]))
                figures = picture_figures(shown[name], truth, {}) | {"psnr_covered": covered["psnr_covered"]}
                for quantity, value in where_seen(figures, truth).items():
                    by_view.setdefault((name, quantity), []).append(value)
        return {key: (fmean if key[0] is None else mean_of_known)(values) for key, values in by_view.items()}

    def one_colour(self) -> Figures:
        """For each message, the mean PSNR of the best single-colour pictures: a floor for readings of the message."""
        floors: dict[tuple[str | None, str], float] = {}
        for name, message in self.messages.items():
            truths = [picture_to_tensor(message.pictures[row]) for row in self.rows]
            floors[name, ONE_COLOUR] = mean_of_known([one_colour_psnr(truth) for truth in truths])
        return floors

    def _truth(self, row: int) -> Float[Tensor, "H W 3"]:
        return picture_to_tensor(self.scene.pictures[row])

    @torch.no_grad()
    def _pictures(self, attacked: Target, wanted: Collection[str]) -> Iterator[dict[str, Float[Tensor, "H W 3"]]]:
        """The wanted pictures of each view: the cover by the attacker's networks, the messages by the secret ones."""
        for name in PUBLIC_NETWORKS:
            if name in self.owner.networks:
                self.owner.networks[name].load_state_dict(attacked.method.networks[name].state_dict())
        cameras = self.scene.cameras.select(self.views)
        for_messages = [name for name in wanted if name != COVER]
        as_left = attacked.gaussians
        opened = self.opened(as_left) if for_messages else as_left
        groups = [(wanted, as_left)] if opened is as_left else [([COVER], as_left), (for_messages, opened)]
        groups = [(names, gaussians.to(self.device)) for names, gaussians in groups]
        moved = replace(cameras, world_to_camera=attacked.motion.world_to_camera(cameras.world_to_camera))
        for camera in single_cameras(moved):
            pictures: dict[str, Float[Tensor, "H W 3"]] = {}
            for names, gaussians in groups:
                rendered = self.owner.render(gaussians, camera, wanted=tuple(names)).pictures
                pictures |= {name: rendered[name].cpu() for name in names}
            if attacked.on_pictures is not None:
                pictures[COVER] = attacked.on_pictures(pictures[COVER].clamp(0, 1))
                if isinstance(self.owner, ReadsRenders) and for_messages:
                    read = self.owner.read_off(pictures[COVER].to(self.device))
                    pictures |= {name: picture.cpu() for name, picture in read.items()}
            yield pictures
