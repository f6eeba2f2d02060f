"""Homogeneous features: GS-Hider with each picture blended only from the Gaussians that belong to it. Not in the paper.

In GS-Hider, all pictures share one opacity, so that a message's surface occludes the cover behind it, and vice versa.
The decoders can only guess from the feature map how much is occluded; with few small photos, they memorise the training
views and fail on others. Here, a feature states along a direction u_k, known only to decoder k, how much of its
Gaussian belongs to picture k. Blended like all else, these shares tell each decoder by how much its picture was
attenuated. It divides by them, as homogeneous coordinates are divided by their weight.

The decoders also see each pixel's viewing direction. The paper names the lack of view dependence as a limitation.
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
"""workflows/figures/tried.md describes how these were found."""

SCENE_PRESETS = {"lambda_message": 0.1, "message_points": 4000}

BELONGING = 0.48
"""A Gaussian's initial share is 0.5 + this in its own picture, and 0.5 - this in the others."""

SMALLEST_SHARE = 0.05
"""ε, added to the divisor: pixels in which a picture has hardly any share come out grey instead of noisy."""

COLORS = 3

READINGS = 7
"""Channels that a decoder reads for each picture, the colours first. It reads features along directions of its own, so
that other pictures' content is not divided by this picture's small share. With one message and M = 16, there is room
for seven orthogonal directions."""

SHARED_WEIGHT = 100.0
"""Weight of the penalty on Gaussians that belong to several pictures: the mean product of their shares in each pair. It
applies to all training views together: with 255 views, a weight of 5 in every step cost the bonsai 0.3 dB."""

BEYOND_WEIGHT = 60.0
"""Weight of the penalty on readings that exceed half a Gaussian's share of the picture. The two penalties together keep
a message's Gaussians from serving the cover as fog that only training views see through: for kitchen hiding bonsai,
with 21 photos, the cover gains 1.6 dB on test views; with either penalty alone it gains 0.4 to 0.8 dB or nothing."""

VIEW_DEGREE = 2
"""Degree of the spherical harmonics that encode a pixel's viewing direction for the decoders."""

VIEW_CHANNELS = harmonics_count(VIEW_DEGREE) - 1
"""All harmonics but the constant one; they are the last channels that the convolutions see."""


class HomogeneousDecoder(torch.nn.Module):
    """Reads features along a few directions, divides by the picture's share, and applies convolutions.

    `directions [P, M]` holds u_k for the P pictures that this decoder shows, `readings [P, R, M]` the rows along which
    it reads each. Both are zero until they are set. For each picture, the convolutions see its divided readings and the
    share itself, which distinguishes black from grey, and then 8 harmonics of the viewing direction.
    """

    reads_centred = True

    def __init__(self, feature_dim: int, pictures: int, layers: int, width: int, kernel_size: int = 3):
        super().__init__()
        self.directions = torch.nn.Parameter(torch.zeros(pictures, feature_dim))
        self.readings = torch.nn.Parameter(torch.zeros(pictures, READINGS, feature_dim))
        self.channels = pictures * (READINGS + 1) + VIEW_CHANNELS
        self.convolutions = Decoder(self.channels, 3 * pictures, layers, width, kernel_size)

    def start(self, directions: Float[Tensor, "P M"], readings: Float[Tensor, "P R M"]) -> None:
        """Initialise to show each picture as its first three readings + 0.5."""
        pictures = len(directions)
        taps = torch.zeros(pictures, COLORS, self.channels)
        for picture in range(pictures):
            first = picture * (READINGS + 1)
            taps[picture, :, first : first + COLORS] = torch.eye(COLORS)
        self.convolutions.pass_through(taps.flatten(0, 1), neutral=0.0)
        self.look_along(directions, readings)

    @torch.no_grad()
    def look_along(self, directions: Float[Tensor, "P M"], readings: Float[Tensor, "P R M"]) -> None:
        """Set the rows along which each picture's share and content are read."""
        self.directions.copy_(directions)
        self.readings.copy_(readings)

    @torch.no_grad()
    def read_along(self, back: Float64[Tensor, "M M"]) -> None:
        """Replace every row r that reads features, centred at 0.5, by r B, with B = `back`."""
        self.directions.copy_(rows_along(self.directions, back))
        self.readings.copy_(rows_along(self.readings, back))

    @torch.no_grad()
    def turn_view(self, rotation: Float64[np.ndarray, "3 3"]) -> None:
        """Adapt the weights to a world turned by `rotation`, so that they respond to viewing directions as before."""
        first = self.convolutions.convolutions[0]
        weights = first.weight[:, -VIEW_CHANNELS:]
        rest = weights.flatten(2).permute(2, 0, 1).reshape(-1, VIEW_CHANNELS, 1)
        turned = turned_harmonics(rest, rotation).reshape(-1, len(weights), VIEW_CHANNELS).permute(1, 2, 0)
        first.weight[:, -VIEW_CHANNELS:] = turned.reshape(weights.shape)

    def divided(
        self, centred: Float[Tensor, "H W M"], half_alphas: Float[Tensor, "H W 1"]
    ) -> list[Float[Tensor, "H W _"]]:
        """For each picture k, its readings of (F - A/2) / (E_k + ε), and its blended share E_k.

        E_k = max(0, u_k·(F - A/2) + A/2), with `centred` = F - A/2 and `half_alphas` = A/2. It multiplies by
        reciprocals, since autograd passes over all features twice as often for a division.
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
    """GS-Hider with decoders that divide by shares first."""

    name = "homogeneous"

    def make_decoder(self, pictures: int, layers: int, width: int, kernel_size: int) -> HomogeneousDecoder:
        """Make a decoder that divides by the shares of this many pictures."""
        return HomogeneousDecoder(self.feature_dim, pictures, layers, width, kernel_size)

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """Features that the decoders show as the points' colours; a point belongs to pictures where it is not grey.

        A point that is grey everywhere belongs to every picture by half. The directions of shares and colours in
        feature space come from `generator`, that is, from the key.
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
        """Set the decoders' directions at random, without colours: features will start at zero."""
        directions, readings = self._drawn(generator)
        for decoder, rows in self._rows():
            decoder.look_along(directions[rows], readings[rows])

    def _drawn(self, generator: np.random.Generator) -> tuple[Float[Tensor, "P M"], Float[Tensor, "P R M"]]:
        """Random directions of each picture's share [P, M] and of its readings [P, R, M].

        They are orthogonal as long as M allows it; shares and colours come first.
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
        """Each of N Gaussians' share of the cover, about 0 to 1; computed from the scene decoder, which is public."""
        return (gaussians[FEATURES].sigmoid() - 0.5) @ self.scene_decoder.directions[0] + 0.5

    def rows_read(self) -> Float[Tensor, "R M"]:
        """The cover's u and readings: the scene decoder sees nothing else of centred features."""
        return torch.cat([self.scene_decoder.directions, self.scene_decoder.readings.flatten(0, 1)])

    def rows_of_messages(self) -> Float[Tensor, "Q M"]:
        """u and the readings of every message. Requires the secret: without it, there is no message decoder."""
        return torch.cat([self.message_decoder.directions, self.message_decoder.readings.flatten(0, 1)])

    def penalty(self, gaussians: Gaussians) -> Float[Tensor, ""] | None:
        """S · mean_i Σ_{k<l} s_k s_l + B · Σ_k mean_ij max(0, |r_kj| - s_k / 2), which separates the pictures.

        S and B are `SHARED_WEIGHT` and `BEYOND_WEIGHT`, s_k the shares of Gaussian i, r_kj its readings. Gradients
        reach the features and the rows of readings; with these rows fixed, the fox's cover would lose 0.5 dB. None
        without a message or without Gaussians.
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
    ) -> list[Float[Tensor, "H W _"]]:
        """Divide the feature map for each picture, append the viewing direction, and run each decoder."""
        view = harmonics(pixel_directions(camera, rendering.alphas.device), VIEW_DEGREE)[..., 1:]
        half_alphas = rendering.alphas[..., None] / 2
        centred = rendering.feature_map - half_alphas
        outputs = []
        for decoder in decoders:
            seen = torch.cat([*decoder.divided(centred, half_alphas), view], dim=-1)
            outputs.append(decode(decoder.convolutions, seen, self.precision))
        return outputs


def build(settings: Mapping[str, object]) -> Homogeneous:
    """Build the method from its settings, which lack `messages` if the secret is not available."""
    return Homogeneous(**settings)  # type: ignore[arg-type]  # a missing or unknown setting raises TypeError by its name
