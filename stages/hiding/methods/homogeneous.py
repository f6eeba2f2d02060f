"""Homogeneous features: GS-Hider in which each picture is blended from the Gaussians that belong to it, whatever else
stands before them. A method of ours, not of the paper.

In GS-Hider all pictures share one opacity, so that a message's surface hides what of the cover lies behind it, and the
other way round. Its decoders can only guess from the feature map how much is hidden; with few small photos they learn
the training views by heart and fail on others. Here a feature says, along a direction u_k that only decoder k knows,
how much its Gaussian belongs to picture k. Blended like the rest, these shares tell each decoder by how much its
picture was weakened, and it divides by them, as homogeneous coordinates are divided by their weight.

The decoders also see from where a pixel is looked at, which the paper names as what its own decoders lack.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from opencl.routes import works_in_place
from opencl.separation import separation_penalty
from stages.hiding.coupled import COUPLED_SETTINGS, FEATURE_RANGE, FEATURES, CoupledFeatures
from stages.hiding.decoders import Decoder, decode, rows_along
from stages.hiding.mixture import orthonormal_rows
from stages.hiding.rendering import COVER, Rendering
from stages.scene.cameras import Camera, pixel_directions
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import turned_harmonics
from stages.scene.spherical_harmonics import harmonics, harmonics_count

SETTINGS = COUPLED_SETTINGS

PRESETS = {
    "decoder_width": 32,
    "kernel_size": 1,
    "averaging": 0.995,
    "opacity_weight": 2.0,
    "scale_weight": 2.0,
}
"""How they were found: workflows/figures/tried.md."""

SCENE_PRESETS = {"lambda_message": 0.1, "message_points": 4000}

BELONGING = 0.48
"""A Gaussian starts with a share of 0.5 + this in its own picture, and 0.5 - this in the others."""

SMALLEST_SHARE = 0.05
"""Added to what is divided by: pixels in which a picture has hardly any share come out grey instead of noisy."""

COLORS = 3

READINGS = 7
"""Channels that a decoder reads of a picture, its colours first: it sees features along directions of its own, and not
what belongs to others divided by its own small share. With one message there is room for seven at right angles."""

SHARED_WEIGHT = 100.0
"""Of the penalty on Gaussians that belong to several pictures: the product of their shares in each two, on average.
Over all training views together: with 255 of them, a weight of 5 in every step cost the bonsai 0.3 dB."""

BEYOND_WEIGHT = 60.0
"""Of the penalty on what a Gaussian holds of a picture beyond its share: how far readings reach past half of it. Both
together keep a message's Gaussians from serving the cover as fog that only training views see through: on kitchen
hiding bonsai, with 21 photos, the cover gains 1.6 dB on test views, and 0.4 to 0.8 or nothing with one of them."""

VIEW_DEGREE = 2
"""Of the spherical harmonics by which the decoders are told a pixel's direction of view."""

VIEW_CHANNELS = harmonics_count(VIEW_DEGREE) - 1
"""The harmonics but the constant one, last among the channels that the convolutions see."""


class HomogeneousDecoder(torch.nn.Module):
    """Features read along a few directions, divided by the share of the picture they belong to, then convolutions.

    `directions [P, M]` are u_k of the P pictures that this decoder shows, `readings [P, R, M]` what it reads of each.
    Both are zeros until they are told. The convolutions see for each picture its divided readings and the share itself,
    without which nothing would tell black from grey, and 8 harmonics of the direction of view.
    """

    reads_centred = True

    def __init__(self, feature_dim: int, pictures: int, layers: int, width: int, kernel_size: int = 3):
        super().__init__()
        self.directions = torch.nn.Parameter(torch.zeros(pictures, feature_dim))
        self.readings = torch.nn.Parameter(torch.zeros(pictures, READINGS, feature_dim))
        self.channels = pictures * (READINGS + 1) + VIEW_CHANNELS
        self.convolutions = Decoder(self.channels, 3 * pictures, layers, width, kernel_size)

    def start(self, directions: Float[Tensor, "P M"], readings: Float[Tensor, "P R M"]) -> None:
        """Start by showing each picture as its first three readings + 0.5."""
        pictures = len(directions)
        taps = torch.zeros(pictures, COLORS, self.channels)
        for picture in range(pictures):
            first = picture * (READINGS + 1)
            taps[picture, :, first : first + COLORS] = torch.eye(COLORS)
        self.convolutions.pass_through(taps.flatten(0, 1), neutral=0.0)
        self.look_along(directions, readings)

    @torch.no_grad()
    def look_along(self, directions: Float[Tensor, "P M"], readings: Float[Tensor, "P R M"]) -> None:
        """Find each picture's share along its direction, and read it along its readings."""
        self.directions.copy_(directions)
        self.readings.copy_(readings)

    @torch.no_grad()
    def read_along(self, back: Float64[Tensor, "M M"]) -> None:
        """Read features, centred at 0.5, along r B where it read them along r; B is `back`."""
        self.directions.copy_(rows_along(self.directions, back))
        self.readings.copy_(rows_along(self.readings, back))

    @torch.no_grad()
    def turn_view(self, rotation: Float64[np.ndarray, "3 3"]) -> None:
        """Read of directions of view in a world that turned by `rotation` what it read of the old ones."""
        first = self.convolutions.convolutions[0]
        told = first.weight[:, -VIEW_CHANNELS:]
        rest = told.flatten(2).permute(2, 0, 1).reshape(-1, VIEW_CHANNELS, 1)
        turned = turned_harmonics(rest, rotation).reshape(-1, len(told), VIEW_CHANNELS).permute(1, 2, 0)
        first.weight[:, -VIEW_CHANNELS:] = turned.reshape(told.shape)

    def divided(
        self, centred: Float[Tensor, "H W M"], half_alphas: Float[Tensor, "H W 1"]
    ) -> list[Float[Tensor, "H W C"]]:
        """For each picture its readings of (F - A/2) / (E_k + ε), and E_k, its blended share: u_k·(F - A/2) + A/2 ≥ 0.

        `centred` is F - A/2, `half_alphas` A/2. Multiplied by reciprocals: of a division, autograd needs twice the
        passes over all features.
        """
        shares = (centred @ self.directions.T + half_alphas).clamp_min(0)
        reciprocals = (shares + SMALLEST_SHARE).reciprocal()
        channels = []
        for readings, share, reciprocal in zip(
            self.readings, shares.split(1, dim=-1), reciprocals.split(1, dim=-1), strict=True
        ):
            channels += [(centred @ readings.T) * reciprocal, share]
        return channels


class Homogeneous(CoupledFeatures[HomogeneousDecoder]):
    """As in GS-Hider, but both decoders divide first."""

    name = "homogeneous"

    def make_decoder(self, pictures: int, layers: int, width: int, kernel_size: int) -> HomogeneousDecoder:
        """A decoder that divides by the shares of so many pictures."""
        return HomogeneousDecoder(self.feature_dim, pictures, layers, width, kernel_size)

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """Features that the decoders show as the points' colours; a point belongs to the pictures where it is not grey.

        One that is grey everywhere belongs to all by half. Where that lies in features is drawn from `generator`, that
        is, from the key.
        """
        pictures = (COVER, *self.messages)
        directions, readings = self._drawn(generator)
        for decoder, rows in self._rows():
            decoder.start(directions[rows], readings[rows])
        centred = torch.stack([torch.as_tensor(colors[name]).float() - 0.5 for name in pictures], dim=1)
        known = (centred != 0).any(dim=-1)
        belongs = torch.where(known, BELONGING, -BELONGING) * known.any(dim=-1, keepdim=True)
        features = 0.5 + belongs @ directions + torch.einsum("npc,pcm->nm", centred, readings[:, :COLORS])
        return {FEATURES: features.clamp(*FEATURE_RANGE).logit()}

    def draw_directions(self, generator: np.random.Generator) -> None:
        """Give the decoders directions without the colours: features are to start with zeros."""
        directions, readings = self._drawn(generator)
        for decoder, rows in self._rows():
            decoder.look_along(directions[rows], readings[rows])

    def _drawn(self, generator: np.random.Generator) -> tuple[Float[Tensor, "P M"], Float[Tensor, "P R M"]]:
        """Random directions for each picture, its share's and its readings'.

        All are at right angles while there is room for them: shares and colours have it first.
        """
        count = 1 + len(self.messages)
        mixture = orthonormal_rows((1 + READINGS) * count, self.feature_dim, generator)
        directions, of_colors, others = mixture.split([count, COLORS * count, (READINGS - COLORS) * count])
        readings = [rows.reshape(count, -1, self.feature_dim) for rows in (of_colors, others)]
        return directions, torch.cat(readings, dim=1)

    def _rows(self) -> list[tuple[HomogeneousDecoder, slice]]:
        """Each decoder, and which of all pictures it shows."""
        return [*zip(self.decoders, (slice(1), slice(1, None)), strict=False)]

    def cover_shares(self, gaussians: Gaussians) -> Float[Tensor, " N"]:
        """How much of each of N Gaussians is the cover's, about 0 to 1: what the scene decoder has is public."""
        return (gaussians[FEATURES].sigmoid() - 0.5) @ self.scene_decoder.directions[0] + 0.5

    def rows_read(self) -> Float[Tensor, "R M"]:
        """u of the cover and the readings of the scene decoder: of centred features it sees nothing else."""
        return torch.cat([self.scene_decoder.directions, self.scene_decoder.readings.flatten(0, 1)])

    def rows_of_messages(self) -> Float[Tensor, "Q M"]:
        """u and the readings of every message; only with the secret there is a message decoder."""
        return torch.cat([self.message_decoder.directions, self.message_decoder.readings.flatten(0, 1)])

    def penalty(self, gaussians: Gaussians) -> Float[Tensor, ""] | None:
        """Σ s_k s_l over pairs of pictures, and Σ max(0, |r_k| - s_k / 2) over pictures and readings, as means.

        s_k are the shares of a Gaussian, r_k its readings. Features change by it, and how long readings are: were they
        fixed, the fox would lose 0.6 dB. Without a message there is none, nor without Gaussians.
        """
        if not self.messages or not len(gaussians):
            return None
        directions = torch.cat([decoder.directions for decoder in self.decoders]).detach()
        readings = torch.cat([decoder.readings for decoder in self.decoders])
        if works_in_place(gaussians.device):
            return separation_penalty(gaussians[FEATURES], directions, readings, SHARED_WEIGHT, BEYOND_WEIGHT)
        centred = gaussians[FEATURES].sigmoid() - 0.5
        shares = (centred @ directions.T + 0.5).clamp(0, 1)
        shared = (shares.sum(dim=1).square() - shares.square().sum(dim=1)) / 2
        held = (centred @ readings.flatten(0, 1).T).abs().unflatten(1, readings.shape[:2])
        beyond = (held - shares.detach()[..., None] / 2).clamp_min(0).mean(dim=(0, 2)).sum()
        return SHARED_WEIGHT * shared.mean() + BEYOND_WEIGHT * beyond

    def decoded(
        self, decoders: Sequence[HomogeneousDecoder], rendering: Rendering, camera: Camera
    ) -> list[Float[Tensor, "H W C"]]:
        """The feature map divided for each picture, beside the direction of view, through each decoder."""
        view = harmonics(pixel_directions(camera, rendering.alphas.device), VIEW_DEGREE)[..., 1:]
        half_alphas = rendering.alphas[..., None] / 2
        centred = rendering.feature_map - half_alphas
        outputs = []
        for decoder in decoders:
            seen = torch.cat([*decoder.divided(centred, half_alphas), view], dim=-1)
            outputs.append(decode(decoder.convolutions, seen, self.precision))
        return outputs


def build(settings: Mapping[str, object]) -> Homogeneous:
    """The method from its settings; `messages` may be absent where the secret is not at hand."""
    return Homogeneous(**settings)  # type: ignore[arg-type]  # a missing or unknown setting raises TypeError by its name
