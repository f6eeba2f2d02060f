"""Whether a picture has the grain of a watermarked container: one number for a whole picture.

Ours, not the paper's, whose decoder has to tell renders from photos by what its convolutions see around each pixel.
Grain is a statistic: a few pixels show it as little as a few throws show a loaded die. So what a neighbourhood speaks
for is averaged over the whole picture.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from stages.hiding.watermark.colors import ACROSS, COLORS, GRAIN, LUMINANCE

HIDDEN = 32

NEIGHBOURHOOD = 9
"""Sides in pixels of what variances are taken of: edges stay apart from plain surfaces."""

FLOOR = 2e-6
"""Added to variances of pictures in [0, 1]: a third of a level, squared, about what rounding to bytes adds."""

FILTERS = torch.tensor(
    [
        [[0, 0, 0, 0, 0], [0, 1, -1, 0, 0], [0, -1, 1, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0]],
        [[0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 1, -2, 1, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0]],
        [[0, 0, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, -2, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0]],
        [[0, 0, 1, 0, 0], [0, 0, 0, 0, 0], [1, 0, -4, 0, 1], [0, 0, 0, 0, 0], [0, 0, 1, 0, 0]],
    ]
).float()
"""Differences between neighbours: diagonal, across, down; and between pixels two apart, for reduced pictures."""


class Gate(torch.nn.Module):
    """From pictures to [0, 1]: 1 for those that carry the grain.

    It sees three logarithms a neighbourhood and filter: of luminance's variance, and of the variances of the grain's
    colour and of the colour across, as far as luminance does not explain them, which it does at the edges of things.
    Nothing in nature prefers the one colour to the other. First weights come from torch's generator.
    """

    def __init__(self) -> None:
        super().__init__()
        channels = 3 * len(FILTERS)
        self.first = torch.nn.Conv2d(channels, HIDDEN, 1)
        self.second = torch.nn.Conv2d(HIDDEN, HIDDEN, 1)
        self.last = torch.nn.Conv2d(HIDDEN, 1, 1)

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 1 1 1"]:
        """Of sRGB in [0, 1], each side at least 13 pixels."""
        values = log_variances(images)
        for layer in (self.first, self.second):
            values = torch.nn.functional.leaky_relu(layer(values))
        return torch.sigmoid(self.last(values).mean(dim=(1, 2, 3), keepdim=True))


def log_variances(images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 12 h w"]:
    """For each filter: luminance, then the colour across the grain's and the grain's own less that, both given
    luminance. Scaled to about -1 to 1.
    """
    filters = FILTERS / FILTERS.square().sum(dim=(1, 2), keepdim=True).sqrt()
    channels = torch.einsum("kc,bchw->bkhw", COLORS, images)
    count = len(images)
    details = torch.nn.functional.conv2d(channels.flatten(0, 1)[:, None], filters[:, None])
    details = details.unflatten(0, (count, 3))
    luminance, grain, across = (details[:, row] for row in (LUMINANCE, GRAIN, ACROSS))

    def averaged(products: Float[Tensor, "B K h w"]) -> Float[Tensor, "B K h w"]:
        return torch.nn.functional.avg_pool2d(products, NEIGHBOURHOOD, stride=NEIGHBOURHOOD // 2)

    variance = averaged(luminance.square()) + FLOOR
    left = [
        (averaged(each.square()) - averaged(each * luminance).square() / variance + FLOOR).log()
        for each in (across, grain)
    ]
    return torch.cat([(variance.log() + 9) / 3, (left[0] + 11) / 3, left[1] - left[0]], dim=1)
